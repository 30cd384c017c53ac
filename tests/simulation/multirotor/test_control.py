"""The flight controller at the limits of its rotors."""

import numpy as np
import pytest

from rotorid_torch.simulation.multirotor.control import MOST, Pose, Targets
from rotorid_torch.simulation.multirotor.flight import Fleet
from rotorid_torch.simulation.multirotor.vehicles import multirotor


def moments(lift: float, turning: float) -> tuple[float, np.ndarray]:
    """Rolling moment over that which is asked for, and commands, of a level quadrotor that shall climb and roll."""
    craft = multirotor("quad")
    fleet = Fleet.of([craft], [craft])
    controller = fleet.controller()
    zero = np.zeros((3, 1))
    targets = Targets(zero, zero, zero, zero[0], zero[:2], zero, np.array([[turning], [0.0], [0.0]]), np.full(1, lift))
    level = Pose(zero, zero, zero, np.stack([np.ones((3, 1)), zero]))
    commands = controller.commands(targets, level, zero, fleet.drives, 0.0)
    speeds = fleet.drives.asked(commands, fleet.drives.reference)
    thrust = (controller.curve * speeds**2)[:, 0]
    rolling = -(np.asarray(craft.places)[:, 1] * thrust).sum()
    return float(rolling / (turning * craft.inertia_matrix[0, 0])), commands


@pytest.mark.parametrize("lift", [200.0, -9.0])
@pytest.mark.parametrize("turning", [5.0, 40.0, 100.0])
def test_where_rotors_reach_a_limit_lift_gives_way_and_the_moment_stays(lift, turning):
    share, commands = moments(lift, turning)
    assert commands.min() > 0.0
    assert commands.max() <= MOST
    assert share == pytest.approx(1.0, abs=1e-9)


def test_a_moment_beyond_the_rotors_is_as_large_as_they_allow():
    share, commands = moments(0.0, 150.0)
    assert share < 1.0
    assert commands.max() == pytest.approx(MOST)
