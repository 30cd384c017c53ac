"""Needs of effects: nothing is said where they are met, and in words what is lacking where not."""

import msgspec
import pytest

from rotorid_torch.effects.base import Effect, Role, Stage
from rotorid_torch.effects.examples import HELICOPTER, MULTIROTOR
from rotorid_torch.effects.testable import Need, Needs, channel, without_motors


class OfAUser(Effect):
    """Drag of somebody's, which asks for more than one thing."""

    id, stage, role = "my.drag", Stage.FORCES, Role.UNDECLARED
    needs = (Needs.VELOCITIES, Needs.FORCES, lambda spec: "no pod is declared" if spec.mass == 1.0 else None)


@pytest.mark.parametrize(
    ("need", "without", "lacking"),
    [
        (Needs.VELOCITIES, {"states": ("p", "q", "r")}, "velocities"),
        (Needs.RATES, {"states": ()}, "rates"),
        (Needs.FORCES, {"patterns": {}}, "specific forces"),
        (Needs.ROTOR, {"rotor": None}, "main rotor"),
        (Needs.MASS, {"mass": None}, "mass is not declared"),
        (Needs.INERTIA, {"inertia": None}, "inertia"),
        (Needs.NOTHING_ASIDE, {"mass_excludes": ("blades", "pod")}, "blades and pod fly along"),
        (Needs.NOT_MULTIROTOR, {"controls": MULTIROTOR.controls}, "a multirotor"),
        (channel("psi"), {"reference": {}}, "channel psi is missing"),
        (without_motors("because"), {"controls": MULTIROTOR.controls}, "because"),
    ],
)
def test_a_need_says_what_is_lacking(need: Need, without: dict, lacking: str):
    assert need(HELICOPTER) is None
    assert lacking in str(need(msgspec.structs.replace(HELICOPTER, **without)))


def test_motors_are_what_a_helicopter_lacks():
    assert Needs.MOTORS(MULTIROTOR) is None
    assert Needs.MOTORS(HELICOPTER) == "the vehicle has no motor commands"


def test_the_first_need_that_is_not_met_is_told():
    assert OfAUser.untestable(HELICOPTER) is None
    assert OfAUser.untestable(msgspec.structs.replace(HELICOPTER, mass=1.0)) == "no pod is declared"
    assert "velocities u v w" in str(OfAUser.untestable(msgspec.structs.replace(HELICOPTER, states=(), mass=1.0)))
