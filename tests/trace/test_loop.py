"""The loop on known models: what is hidden is named, with its size; where nothing is hidden nothing is named."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from types import SimpleNamespace

import pytest
import torch

from rotorid_torch.data import Dataset
from rotorid_torch.identification.reconstruct import reconstruct
from rotorid_torch.identification.step2 import regress_model
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.decide import gain, smallest_visible
from rotorid_torch.trace.fits import CAREFUL, Fitted, Flights, refit
from rotorid_torch.trace.floor import Floors
from rotorid_torch.trace.loop import Tracing, _Search, trace
from rotorid_torch.trace.screen import Screen, _ranges, screen, signatures
from tests.known_models import flown, manoeuvres, rate_vehicle, with_values

DT = 0.02
SUSPECTS = ("control.delay", "control.lag", "forces.quadratic_damping")


def flights(*effects: str, seed: int = 3, **values: float) -> Dataset:
    names = {f"{e.replace('__', '.')}": v for e, v in values.items()}
    truth = with_values(rate_vehicle(effects=effects), names)
    moves = manoeuvres(8.0, DT)
    both = {**moves, **{f"{name}_again": -0.8 * move for name, move in moves.items()}}
    lists = {"identify": list(moves), "validate": [f"{name}_again" for name in moves]}
    return flown(truth, both, DT, noise=0.02, seed=seed, lists=lists)


def started(data: Dataset) -> tuple[Flights, Fitted]:
    found = reconstruct(data)
    spec = propose(data, found)
    model = build(spec)
    start = regress_model(model, data, found)
    known = Flights(data, found)
    values = dict(zip(model.parameter_set.names, start.theta.tolist(), strict=True))
    return known, refit(spec, known, values, start.held)


def traced(data: Dataset) -> Tracing:
    known, null = started(data)
    return trace(null.spec, null.values, (), known, lambda spec, effects: Floors({}, "none drawn"))


def test_the_screen_sees_the_size_of_a_delay():
    _, null = started(flights("control.delay", control__delay__common=0.06))
    seen = screen(null, SUSPECTS)
    assert seen.sizes(["control.delay"])["control.delay.common"] == pytest.approx(0.06, abs=0.02)
    assert seen.gain(["control.delay"]) > 10.0 * float(seen.by_chance("control.delay").max())


@pytest.mark.parametrize("inverse", [1.2, 6.0])
def test_the_screen_sees_fast_and_slow_rate_limits_where_they_act(inverse: float):
    """A limit that steps hardly meet is no small share of one that hardly lets them through."""
    _, null = started(flights("control.rate_limit", control__rate_limit__inverse=inverse))
    seen = screen(null, ("control.rate_limit", *SUSPECTS))
    assert seen.gain(["control.rate_limit"]) > max(seen.gain([e]) for e in SUSPECTS)
    starts = [one["control.rate_limit.inverse"] for one in seen.starts("control.rate_limit")]
    assert any(0.5 * inverse < start < 2.0 * inverse for start in starts)


def test_an_effect_is_screened_whole_at_every_size_that_one_of_its_parameters_is_met_at():
    model = rate_vehicle(effects=("forces.quadratic_damping",))
    kinds = {"forces.quadratic_damping.L": (0.1, 0.01)}
    known = [replace(p, met=kinds.get(p.name, ())) for p in model.parameter_set.parameters]
    seen = signatures(SimpleNamespace(parameter_set=SimpleNamespace(parameters=known)), ["forces.quadratic_damping"])  # pyright: ignore[reportArgumentType]
    names = {s.parameter for s in seen}
    assert len(names) == 3
    groups = [list(together) for _, together in groupby(seen, key=lambda one: one.kind)]
    assert [{s.parameter for s in one} for one in groups] == [names] * 3
    sizes = {name: [s.typical for s in seen if s.parameter == name] for name in names}
    assert sizes["forces.quadratic_damping.L"][1:] == [0.1, 0.01]
    assert len(set(sizes["forces.quadratic_damping.M"])) == 1


def test_what_flights_show_of_an_effect_does_not_hang_on_what_they_hold():
    """Its usual size, not the one at which chance explains most."""
    seen = [screen(started(flights(seed=seed))[1], ("control.rate_limit",)) for seed in range(3, 7)]
    visible = [smallest_visible(one, "control.rate_limit", 1e-3) for one in seen]
    sizes = [size for size, _ in filter(None, visible)]
    assert len(sizes) == len(seen)
    assert max(sizes) < 1.1 * min(sizes)


def test_a_smaller_size_speaks_for_one_with_which_trajectories_leave_all_that_was_measured(
    monkeypatch: pytest.MonkeyPatch,
):
    """Quadratic damping saturates: the gain of little of it, in proportion, is that of its slope at nothing."""
    damping = "forces.quadratic_damping"
    _, null = started(flights(damping, forces__quadratic_damping__L=0.6))
    usual = signatures(build(null.spec.with_effects(damping)), [damping])

    def seen(part: float) -> Screen:
        own = tuple(replace(s, typical=part * s.typical) for s in usual)
        monkeypatch.setattr("rotorid_torch.trace.screen.signatures", lambda model, effects: own)
        return screen(null, [damping])

    slope, whole = (seen(part).sizes([damping])[f"{damping}.L"] for part in (2.0**-6, 8.0))
    assert abs(whole / slope - 1.0) > 0.5  # at 16 1/rad nothing is in proportion
    monkeypatch.setattr("rotorid_torch.trace.screen._ranges", lambda outputs, noise: torch.full((), 1e-4))
    assert seen(1.0).sizes([damping])[f"{damping}.L"] == pytest.approx(slope, rel=0.05)


def test_an_output_that_never_moved_says_nothing_of_what_is_large():
    """Missing, still, noise alone, moving."""
    noise = torch.tensor([0.1, 0.1, 0.1, 0.1], dtype=torch.float64)
    moving = torch.linspace(-3.0, 5.0, 60, dtype=torch.float64)
    chance = 0.1 * torch.randn(60, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    outputs = torch.stack([torch.full_like(moving, math.nan), torch.ones_like(moving), chance, moving], dim=-1)
    outputs[::7, 3] = math.nan
    assert _ranges(outputs, noise)[:3].isinf().all()
    assert float(_ranges(outputs, noise)[3]) == pytest.approx(8.0, rel=0.05)


def test_a_hidden_rate_limit_is_told_from_a_delay():
    found = traced(flights("control.rate_limit", control__rate_limit__inverse=1.2))
    assert found.accepted == ("control.rate_limit",)
    value, error = next(f for f in found.findings if f.id == "control.rate_limit").values["control.rate_limit.inverse"]
    assert abs(value - 1.2) < 3.0 * error


def test_one_late_control_is_found_where_all_together_are_not_late():
    """What the model lacks makes the other one lead by as much."""
    late = {"control__delay__lat": 0.06, "control__delay__lon": -0.06}
    found = traced(flights("control.delay", **late))
    assert found.accepted == ("control.delay",)
    finding = next(f for f in found.findings if f.id == "control.delay")
    assert finding.gain is not None
    assert finding.floor is not None
    assert finding.gain > finding.floor
    value, error = finding.values["control.delay.lat"]
    assert abs(value - 0.06) < 3.0 * error + 2e-3
    assert finding.values["control.delay.lon"][0] == 0.0
    assert finding.values["control.delay.common"][0] == 0.0
    assert found.final.spec.each_control == ("control.delay",)
    assert build(found.null.spec).parameter_set.names  # and the model without it is whole


def test_fits_go_on_while_they_gain_what_matters_to_each(monkeypatch: pytest.MonkeyPatch):
    known, null = started(flights())
    rough = refit(null.spec, known, {}, options=replace(CAREFUL, max_iterations=1))
    monkeypatch.setattr("rotorid_torch.trace.loop.CAREFUL", replace(CAREFUL, max_iterations=1))
    monkeypatch.setattr("rotorid_torch.trace.loop.LONGEST", 30)
    search = _Search(known, (), Floors({}, ""), lambda line: None, 0)
    on = search.gone_on({"careful": rough, "easy": rough}, {"careful": 0.0, "easy": math.inf})
    assert on["careful"].cost == pytest.approx(null.cost, abs=1.0)
    assert on["careful"].cost + 10.0 < on["easy"].cost < rough.cost


def test_a_hidden_delay_is_named_with_its_size():
    found = traced(flights("control.delay", control__delay__common=0.06))
    assert found.accepted == ("control.delay",)
    told = next(f for f in found.findings if f.id == "control.delay")
    value, error = told.values["control.delay.common"]
    assert isinstance(found.null, Fitted)
    assert isinstance(found.final, Fitted)
    assert told.gain == pytest.approx(gain(found.null, found.final), rel=0.01)
    assert abs(value - 0.06) < 3.0 * error
    assert error < 0.01


def test_a_hidden_lag_is_told_from_a_delay():
    found = traced(flights("control.lag", control__lag__common=0.08))
    assert found.accepted == ("control.lag",)
    assert next(f for f in found.findings if f.id == "control.delay").verdict == "rejected"


def test_a_lag_that_is_promising_is_weighed_against_a_delay_whatever_the_screen_says_of_that():
    known, null = started(flights("control.lag", control__lag__common=0.08))
    level, said = torch.full((24,), 1e-4, dtype=torch.float64), []

    def floors(model: object, effects: Sequence[str]) -> Floors:
        each = {e: 1e6 * level for e in effects if e.startswith("control.")}
        return Floors({e: 1e6 * level if e == "control.delay" else level for e in effects}, "", each_control=each)

    found = trace(null.spec, null.values, (), known, floors, said.append)
    assert found.accepted == ("control.lag",)
    assert any(line.startswith("control.delay: gain ") for line in said)


def test_where_nothing_is_hidden_nothing_is_named():
    found = traced(flights())
    assert found.accepted == ()
    assert found.structure == ()
    assert {f.verdict for f in found.findings} <= {"below floor", "indistinguishable", "not testable", "rejected"}
    delay = next(f for f in found.findings if f.id == "control.delay")
    assert delay.smallest_visible is not None
    assert delay.smallest_visible[0] < 0.06


def test_screens_repeat_exactly():
    _, null = started(flights())
    one, two = (screen(null, SUSPECTS, seed=5) for _ in range(2))
    assert torch.equal(one.products, two.products)


def test_a_parameter_that_cannot_be_told_has_no_finite_error():
    known, null = started(flights())
    twice = refit(null.spec, known, null.values, held=[n for n in null.names if n != "forces.L.p"])
    assert 0.0 < twice.error("forces.L.p") < math.inf
    assert twice.error("forces.L.lat") == math.inf
    blind = replace(
        twice, fit=replace(twice.fit, minimum=replace(twice.fit.minimum, not_identifiable=torch.ones(1) > 0))
    )
    assert blind.error("forces.L.p") == math.inf
