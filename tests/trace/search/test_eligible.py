"""Which effects a model's data set can test, and what is said of the others."""

from __future__ import annotations

import msgspec

from rotorid_torch.data import Dataset
from rotorid_torch.effects.examples import HELICOPTER, MULTIROTOR
from rotorid_torch.trace.search.eligible import candidates, judging
from tests.helpers import small_flight


def test_what_the_nominal_model_has_is_told_as_part_of_it():
    spec = msgspec.structs.replace(HELICOPTER, inflow=True)
    testable, settled = candidates(spec)
    told = {f.id: f for f in settled}
    for effect in ("rotor.inflow", "forces.translational_lift"):
        assert effect not in testable
        assert told[effect].verdict == "accepted"
        assert told[effect].part == "inflow"
    assert {"rotor.inflow", "forces.translational_lift"} <= set(candidates(HELICOPTER)[0])


def test_moments_of_flapping_blades_can_join_the_rotors():
    assert "propulsion.flapping" in candidates(MULTIROTOR)[0]


def test_a_flight_that_lacks_what_others_measure_judges_no_effect():
    """Without velocities drag and wind do nothing, and would be refused for it."""
    whole, poor = small_flight(), small_flight()
    for name in ("u", "v"):
        del poor[name]
    dataset = Dataset.from_arrays({"f": whole, "g": whole, "h": poor}, identify=["f"], validate=["g", "h"])
    seen, notes = judging(dataset, ("u", "v", "p", "q", "r", "a1", "vi"))
    assert seen.validate == ("g",)
    assert notes == ("flight h: no u, v, which the model has as states: the flight judges no effect",)
    assert judging(seen, ("u", "v", "p"))[1] == ()
