"""The screen: what each effect would explain beside the free derivatives, and at which size."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import groupby

import pytest
import torch
from torch import Tensor

from rotorid_torch.core.parameters import ParameterSet
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.held_out import FlightEquations
from rotorid_torch.trace.evidence.screen import Screen, Signature, output_ranges, screen, signatures, sized
from tests.known_models import rate_vehicle
from tests.trace.hidden_flights import SUSPECTS, flights, started


def test_the_screen_sees_the_size_of_a_delay():
    _, null = started(flights("control.delay", control__delay__common=0.06))
    seen = screen(null, SUSPECTS, shuffles=19)
    assert seen.sizes(["control.delay"])["control.delay.common"] == pytest.approx(0.06, abs=0.02)
    chance = [float(seen.evidence("control.delay", 1 + turn).sum()) for turn in range(19)]
    assert float(seen.evidence("control.delay").sum()) > 10.0 * max(chance)
    assert len(seen.evidence("control.delay")) == 8
    assert bool((seen.evidence("control.delay") > 0.0).all())  # each flight, estimated from others


@pytest.mark.parametrize("inverse", [1.2, 6.0])
def test_the_screen_sees_fast_and_slow_rate_limits_where_they_act(inverse: float):
    """A limit that steps hardly meet is no small share of one that hardly lets them through."""
    _, null = started(flights("control.rate_limit", control__rate_limit__inverse=inverse))
    seen = screen(null, ("control.rate_limit", *SUSPECTS))
    found = {c.name: float(seen.evidence(c.name).sum()) for c in seen.candidates}
    assert max(found, key=lambda e: found[e]) == "control.rate_limit"
    starts = [one["control.rate_limit.inverse"] for one in seen.starts("control.rate_limit")]
    assert any(0.5 * inverse < start < 2.0 * inverse for start in starts)


def equations_of(products: Tensor) -> FlightEquations:
    """Of one flight, whose model has no parameters."""
    return FlightEquations(products[None, None], products[None, None][:0], 0.0 * products, 0)


def test_a_size_below_nothing_is_told_where_bounds_are_left_out():
    """Of a residual that is twice the signature, the other way round."""
    lead = Signature("control.delay", "control.delay.common", 0.0, 0.06, (0.0, 0.4), "s")
    one = torch.tensor([[1.0, -2.0], [-2.0, 4.0]], dtype=torch.float64)
    found = Screen((lead,), (), equations_of(one))
    assert found.sizes(["control.delay"]) == {"control.delay.common": 0.0}
    assert found.unbounded("control.delay") == {"control.delay.common": pytest.approx(-0.12)}


def test_a_size_beside_another_at_its_bound_is_the_best_there():
    """Without bounds -0.8 and 2.3; within 0 to 2 the best are 0 and 0.7, not 0 and 2."""
    A = torch.tensor([[1.0, 1.0, 1.5], [3.0, 1.0, -0.1]], dtype=torch.float64)
    two = tuple(Signature("my.effect", f"my.effect.{n}", 0.0, 1.0, (0.0, 2.0), "") for n in "ab")
    found = Screen(two, (), equations_of(A.mT @ A))
    assert found.sizes(["my.effect"]) == {"my.effect.a": 0.0, "my.effect.b": pytest.approx(0.7)}


def test_a_model_has_its_values_back_where_a_size_of_an_effect_fails():
    model = rate_vehicle(effects=("forces.quadratic_damping",))
    before = model.theta.detach().clone()
    with pytest.raises(ArithmeticError), sized(model, signatures(model, ["forces.quadratic_damping"])[0]):
        raise ArithmeticError
    assert torch.equal(model.theta.detach(), before)


def test_an_effect_is_screened_whole_at_every_size_that_one_of_its_parameters_is_met_at():
    model = rate_vehicle(effects=("forces.quadratic_damping",))
    kinds = {"forces.quadratic_damping.L": (0.1, 0.01)}
    parameters = model.parameter_set.parameters
    model.parameter_set = ParameterSet(tuple(replace(p, met=kinds.get(p.name, ())) for p in parameters))
    seen = signatures(model, ["forces.quadratic_damping"])
    names = {s.parameter for s in seen}
    assert len(names) == 3
    groups = [list(together) for _, together in groupby(seen, key=lambda one: (one.others, one.size))]
    assert [{s.parameter for s in one} for one in groups] == [names] * 3
    sizes = {name: [s.typical for s in seen if s.parameter == name] for name in names}
    assert sizes["forces.quadratic_damping.L"][1:] == [0.1, 0.01]
    assert len(set(sizes["forces.quadratic_damping.M"])) == 1


def test_what_flights_show_of_an_effect_does_not_hang_on_what_they_hold():
    """Its usual size, not the one at which chance explains most."""
    seen = [screen(started(flights(seed=seed))[1], ("control.rate_limit",)) for seed in range(3, 7)]
    sizes = [size for size, _ in filter(None, (one.visible("control.rate_limit", 0.01) for one in seen))]
    assert len(sizes) == len(seen)
    assert max(sizes) < 1.1 * min(sizes)


def test_a_visible_size_is_expected_to_give_its_statistic():
    """And a statistic that no size within the bounds gives has none."""
    seen = screen(started(flights())[1], SUSPECTS)
    for effect in SUSPECTS:
        sizes = []
        for statistic in (0.01, 0.1, 0.5):
            size, unit = seen.visible(effect, statistic) or pytest.fail(effect)
            first = next(s for s in seen.signatures if s.effect == effect)
            assert seen.expected(effect, size / abs(first.step)) == pytest.approx(statistic, rel=1e-6)
            assert unit == first.unit
            sizes.append(size)
        assert sizes == sorted(sizes)
        assert seen.visible(effect, 1e9) is None
        beyond = seen.expected(effect, 1.01 * max(first.reach))
        assert seen.visible(effect, beyond) is None


def test_a_hidden_effect_gives_the_statistic_that_its_size_is_expected_to():
    """By flights without it, where nothing else is left beside the noise."""
    seen, hidden = (
        screen(started(flights("control.delay", control__delay__common=delay))[1], SUSPECTS) for delay in (0.0, 0.02)
    )
    typical = next(s for s in seen.signatures if s.effect == "control.delay").step
    wanted = seen.expected("control.delay", 0.02 / typical)
    assert float(hidden.evidence("control.delay").sum()) == pytest.approx(wanted, rel=0.3)


def test_a_smaller_size_speaks_for_one_with_which_trajectories_leave_all_that_was_measured(
    monkeypatch: pytest.MonkeyPatch,
):
    """Quadratic damping saturates: the gain of little of it, in proportion, is that of its slope at nothing."""
    damping = "forces.quadratic_damping"
    _, null = started(flights(damping, forces__quadratic_damping__L=0.6))
    usual = signatures(build(null.spec.with_effects(damping)), [damping])

    def seen(part: float) -> Screen:
        own = tuple(replace(s, typical=part * s.typical) for s in usual)
        monkeypatch.setattr(
            "rotorid_torch.trace.evidence.screen.signatures", lambda model, effects: own if effects else ()
        )
        return screen(null, [damping])

    slope, whole = (seen(part).sizes([damping])[f"{damping}.L"] for part in (2.0**-6, 8.0))
    assert abs(whole / slope - 1.0) > 0.5  # at 16 1/rad nothing is in proportion
    monkeypatch.setattr(
        "rotorid_torch.trace.evidence.screen.output_ranges", lambda outputs, noise: torch.full((), 1e-4)
    )
    assert seen(1.0).sizes([damping])[f"{damping}.L"] == pytest.approx(slope, rel=0.05)


def test_an_output_that_never_moved_says_nothing_of_what_is_large():
    """Missing, still, noise alone, moving."""
    noise = torch.tensor([0.1, 0.1, 0.1, 0.1], dtype=torch.float64)
    moving = torch.linspace(-3.0, 5.0, 60, dtype=torch.float64)
    chance = 0.1 * torch.randn(60, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    outputs = torch.stack([torch.full_like(moving, math.nan), torch.ones_like(moving), chance, moving], dim=-1)
    outputs[::7, 3] = math.nan
    assert output_ranges(outputs, noise)[:3].isinf().all()
    assert float(output_ranges(outputs, noise)[3]) == pytest.approx(8.0, rel=0.05)


def test_screens_repeat_exactly():
    _, null = started(flights())
    one, two = (screen(null, SUSPECTS, seed=5) for _ in range(2))
    assert torch.equal(one.equations.total, two.equations.total)


def test_sizes_do_not_ask_flights_that_no_fit_has_seen():
    null = started(flights())[1]
    fitted_alone = replace(null.flights, dataset=replace(null.flights.dataset, validate=()))
    whole, fitted = screen(null, SUSPECTS), screen(replace(null, flights=fitted_alone), SUSPECTS)
    assert fitted.sizes(SUSPECTS) == whole.sizes(SUSPECTS)
    assert len(fitted.evidence(SUSPECTS[0])) == len(null.flights.dataset.identify) < len(whole.evidence(SUSPECTS[0]))
