"""Effects of users that declare no typical size are screened, found where they act, and no reason to stop."""

from __future__ import annotations

import math

import pytest
import torch

from rotorid_torch.core.parameters import Parameter
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values
from rotorid_torch.effects.registry import EFFECTS, registered
from rotorid_torch.trace.search.screening_sizes import FACTOR, MOST, _size, with_screening_sizes
from tests.effects.own_effects import OwnGain, OwnLag
from tests.trace.hidden_flights import flights, started, traced


class OwnNothing(Effect):
    """Acts on a signal that never moves."""

    id, stage, role = "own.nothing", Stage.FORCES, Role.UNDECLARED

    def __init__(self) -> None:
        super().__init__((Parameter("k", 0.0, "1", (-1.0, 1.0)),))

    def forward(self, frame: Frame, x: torch.Tensor, p: Values) -> tuple[Frame, torch.Tensor]:
        nothing = 0.0 * frame.signals["p"] * p["k"]
        return frame.add(moment=torch.stack([nothing] * 3, dim=-1)), x


@pytest.fixture(autouse=True)
def own_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    registered()
    for own in (OwnLag, OwnGain, OwnNothing):
        monkeypatch.setitem(EFFECTS, own.id, own)


def test_what_moves_the_outputs_has_a_size_and_what_shapes_it_has_none():
    known, null = started(flights())
    spec, testable, unmoved = with_screening_sizes(
        null.spec, null.values, known.dataset, ["own.lag", "own.gain", "own.nothing", "control.delay"]
    )
    assert set(spec.screening_sizes) == {"own.lag.L", "own.gain.k"}
    assert abs(spec.screening_sizes["own.gain.k"]) < 0.5
    assert testable == ["own.lag", "own.gain", "control.delay"]
    assert [(f.id, f.verdict) for f in unmoved] == [("own.nothing", "not testable")]


def test_sizes_are_those_beside_a_model_without_the_effect():
    """Whatever sizes the effect had in a model that is compared: at nothing its time constant changes nothing."""
    known, null = started(flights())
    fitted = {**null.values, "own.lag.L": 25.0, "own.lag.tau": 0.4}
    spec, _, _ = with_screening_sizes(null.spec, fitted, known.dataset, ["own.lag"])
    assert set(spec.screening_sizes) == {"own.lag.L"}


@pytest.mark.parametrize("slope", [1e-4, 1.0, 1e5])
@pytest.mark.parametrize("bounds", [(0.0, 1.0), (-2.0, 0.0), (-math.inf, math.inf)])
def test_a_size_changes_the_outputs_visibly_and_little(slope: float, bounds: tuple[float, float]):
    declared = Parameter("k", 0.0, "1", bounds)
    size = _size(declared, lambda name, value: slope * abs(value))
    assert size is not None
    assert bounds[0] < size < bounds[1]
    assert slope * abs(size) <= MOST
    assert slope * abs(size) >= MOST / FACTOR or abs(size) == 0.5 * min(abs(b) for b in bounds if b)


def test_a_size_lies_beyond_a_threshold():
    size = _size(Parameter("k", 0.0, "1", (0.0, 10.0)), lambda name, value: 0.5 * (value > 0.3))
    assert size is not None
    assert size > 0.3


@pytest.mark.slow
def test_what_a_user_s_effect_explains_is_named():
    found = traced(flights("own.lag", own__lag__L=25.0, own__lag__tau=0.4))
    assert found.accepted == ("own.lag",)
    finding = next(f for f in found.findings if f.id == "own.lag")
    value, error = finding.values["own.lag.tau"]
    assert abs(value - 0.4) < 3.0 * error
    assert finding.smallest_visible is not None


def test_installed_effects_name_nothing_where_nothing_is_hidden():
    found = traced(flights())
    assert found.accepted == ()
    assert {"own.lag", "own.gain", "own.nothing"} <= {f.id for f in found.findings}
