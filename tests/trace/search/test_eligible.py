"""Which effects a model's data set can test, and what is said of the others."""

from __future__ import annotations

import msgspec

from rotorid_torch.effects.examples import HELICOPTER
from rotorid_torch.trace.search.eligible import candidates


def test_what_the_nominal_model_has_is_told_as_part_of_it():
    spec = msgspec.structs.replace(HELICOPTER, inflow=True)
    testable, settled = candidates(spec)
    told = {f.id: f for f in settled}
    for effect in ("rotor.inflow", "forces.translational_lift"):
        assert effect not in testable
        assert told[effect].verdict == "accepted"
        assert told[effect].part == "inflow"
    assert {"rotor.inflow", "forces.translational_lift"} <= set(candidates(HELICOPTER)[0])
