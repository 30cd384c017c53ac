"""What has no name is described by equation and kind: with what it goes, how, since when, held out flight by flight."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from rotorid_torch.trace.evidence.critical_values import Draws
from rotorid_torch.trace.evidence.residual import LeftOver, Regressor, onsets
from rotorid_torch.trace.evidence.unattributed import Description, Residuals, Shape
from rotorid_torch.trace.terms.settings import SETTINGS
from tests.trace.evidence.left_overs import COL, FLIGHTS, NAMES, ROWS, TIME, P, Q, U, after, left, shorter


def described(over: LeftOver, unseen: LeftOver | None = None) -> dict[str, Description]:
    return Residuals(over, unseen).descriptions()


def largest(found: dict[str, Description], row: str) -> Description:
    """Of an equation, whatever its kind."""
    return max((one for one in found.values() if one.row == row), key=lambda one: one.statistic)


def test_a_product_is_found_in_its_equation():
    found = described(left("L", P * COL))
    assert largest(found, "L").regressor == ("p col", "by their product", None)
    assert largest(found, "L").member == "unattributed L, curve"
    assert largest(found, "L").statistic > 0.5
    assert max(largest(found, row).statistic for row in ROWS if row != "L") < 0.05


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        (lambda x: torch.tanh(3.0 * x), "levelling off"),
        (lambda x: x * x.abs(), "growing faster than it"),
        (torch.square, "by its square"),
    ],
)
def test_a_curve_over_one_channel_is_told_by_the_channel_and_its_shape(shape, said: str):
    assert largest(described(left("M", shape(Q))), "M").regressor == ("q", said, None)


def test_what_begins_late_is_dated():
    found = largest(described(left("M", Q * after(6.0))), "M")
    assert found.regressor.signal == "q"
    assert found.regressor.since_s == pytest.approx(6.0, abs=0.5)
    assert found.member == "unattributed M, onset"


def test_there_is_one_description_of_each_equation_and_kind():
    found = described(left("L", None))
    assert set(found) == {f"unattributed {row}, {shape.value}" for row in ROWS for shape in Shape}
    assert all(one.member == key for key, one in found.items())


def test_a_drift_is_no_step():
    """A line in time looks like a step in its middle; a step looks less like a line."""
    for made, stands in ((0.03 * TIME, False), (0.2 * after(6.0), True)):
        found = described(left("Y", made))["unattributed Y, step"]
        assert found.regressor.since_s == pytest.approx(6.0, abs=0.5)
        assert (found.statistic > 0.03) is stands
        assert stands or found.statistic < 0.01


def test_what_linear_terms_can_take_up_is_not_left_over():
    assert largest(described(left("N", 3.0 * U)), "N").statistic < 0.02


def test_what_another_size_of_a_named_effect_explains_is_not_left_over():
    over = left("L", P * COL)
    change = torch.zeros_like(over.residual)[..., None]
    change[:, ROWS.index("L"), 0] = 0.1 * P * COL
    assert largest(described(over), "L").statistic > 0.5
    assert largest(described(replace(over, named=change)), "L").statistic < 0.05


def refitted(sides: list[LeftOver], row: str, columns: list[Tensor]) -> list[float]:
    """Parts of T by explicit least squares of the flights that estimate, one scored flight after the other."""
    k = ROWS.index(row)
    flights: list[list[tuple[np.ndarray, np.ndarray]]] = []
    for side, column in zip(sides, columns, strict=True):
        linear = torch.cat([side.signals, side.constants], dim=1).numpy()
        x, r = (v - linear @ np.linalg.lstsq(linear, v)[0] for v in (column.numpy(), side.residual[:, k].numpy()))
        flights.append([(x[m], r[m]) for m in ((side.flight == f).numpy() for f in side.flight.unique())])
    falls = []
    for place, (x, r) in enumerate(flights[0]):
        xs, rs = (np.concatenate(v) for v in zip(*(one for k, one in enumerate(flights[0]) if k != place), strict=True))
        falls.append((r @ r) - np.square(r - np.linalg.lstsq(xs[:, None], rs)[0] * x).sum())
    xs, rs = (np.concatenate(v) for v in zip(*flights[0], strict=True))
    size = np.linalg.lstsq(xs[:, None], rs)[0]
    falls += [(r @ r) - np.square(r - size * x).sum() for side in flights[1:] for x, r in side]
    samples, squares = (sum(f(r) for side in flights for _, r in side) for f in (len, lambda r: r @ r))
    return [fall / math.sqrt(samples * squares) for fall in falls]


@pytest.mark.parametrize("held_back", [False, True])
def test_the_statistic_is_that_of_explicit_refits_without_each_flight(held_back: bool):
    over, other = left("L", 0.7 * P * COL, 0.8), left("L", 0.4 * P * COL, 0.6)
    other = replace(other, residual=other.residual.flip(0))
    sides = [over, other] if held_back else [over]
    residuals = Residuals(*sides)
    for regressor, column in (
        (Regressor("p col", "by their product"), P * COL),
        (Regressor("q", since_s=6.0), Q * after(6.0)),
    ):
        found = residuals.of("L", regressor)
        wanted = refitted(sides, "L", [column] * len(sides))
        assert len(wanted) == FLIGHTS * len(sides)
        assert found.evidence.numpy() == pytest.approx(wanted, rel=1e-8)
        assert found.statistic == pytest.approx(sum(wanted), rel=1e-8)


def test_the_statistic_has_the_unit_of_the_equation():
    """s^2 / sqrt(s^2 + n^2) of a part of rms s beside noise of rms n; twice the residual is twice the statistic."""
    product = P * COL
    over = left("L", product, 1.0)
    rms = float(over.beyond(product[:, None], ROWS.index("L")).square().mean().sqrt())
    found = Residuals(over).of("L", Regressor("p col", "by their product")).statistic
    assert found == pytest.approx(rms**2 / math.hypot(rms, 1.0), rel=0.15)
    twice = replace(over, residual=2.0 * over.residual)
    assert Residuals(twice).of("L", Regressor("p col", "by their product")).statistic == pytest.approx(2.0 * found)


def test_what_unseen_flights_do_not_show_counts_against_a_description():
    product = P * COL
    over = left("L", product)
    named = Regressor("p col", "by their product")
    same, less, none, other = (
        Residuals(over, left("L", size * product)).of("L", named) for size in (1.0, 0.5, 0.0, -1.0)
    )
    assert same.statistic > less.statistic > none.statistic > other.statistic
    assert bool((none.evidence[FLIGHTS:] < 0.0).all())
    assert other.statistic < 0.0


def test_one_flight_alone_confirms_nothing():
    over = left("L", P * COL)
    alone = replace(over, flight=torch.zeros_like(over.flight))
    assert not any(one.evidence.any() for one in described(alone).values() if not one.member.endswith("step"))
    assert largest(described(alone, over), "L").regressor.signal == "p col"  # unseen flights do


def test_what_begins_after_the_end_of_unseen_flights_is_shown_by_the_fitted_ones_alone():
    over = left("M", Q * after(6.0))
    found = described(over, shorter(over, 5.0))["unattributed M, onset"]
    assert found.regressor.since_s == pytest.approx(6.0, abs=0.5)
    assert not found.evidence[FLIGHTS:].any()
    assert found.evidence[:FLIGHTS].sum() > 0.1


def test_flights_too_short_to_have_a_middle_have_no_onset():
    over = shorter(left("M", P * Q), 3.0)
    assert not [named for named, _ in onsets(over, 0.5)]
    found = described(over)
    assert set(found) == {f"unattributed {row}, curve" for row in ROWS}
    assert largest(found, "M").regressor.signal == "p q"


def test_steps_among_the_linear_terms_leave_no_step():
    residuals = Residuals(left("L", after(6.0)))
    before, again = (
        one.descriptions()["unattributed L, step"].statistic
        for one in (residuals, residuals.less_beginning(6.0, signals=False))
    )
    assert before > 0.15
    assert again < 0.02


def test_an_equation_that_unseen_flights_have_not_is_described_by_the_fitted_ones():
    over = left("N", P * COL)
    other = left("N", P * COL)
    lacking = replace(other, rows=other.rows[:-1], residual=other.residual[:, :-1], named=other.named[:, :-1])
    found = described(over, lacking)["unattributed N, curve"]
    assert len(found.evidence) == FLIGHTS
    assert found.regressor.signal == "p col"


def test_chance_reaches_what_nothing_explains_and_falls_short_of_what_something_does():
    nothing, over = Residuals(left("L", None)), Residuals(left("L", 0.2 * P * COL))
    names = nothing.by_chance(19, 0)
    assert names.keys() == nothing.descriptions().keys()
    p = Draws(names).adjusted_p({key: one.statistic for key, one in nothing.descriptions().items()})
    assert min(p.values()) > SETTINGS.level
    p = Draws(over.by_chance(19, 0)).adjusted_p({key: one.statistic for key, one in over.descriptions().items()})
    low = [key for key, one in p.items() if one <= SETTINGS.level]
    assert {key.split(",")[0] for key in low} == {"unattributed L"}
    assert max(low, key=lambda key: over.descriptions()[key].statistic) == "unattributed L, curve"


def test_chance_repeats_by_seed():
    residuals = Residuals(left("L", 0.2 * P * COL), left("L", None))
    one, two, other = (residuals.by_chance(5, seed) for seed in (3, 3, 4))
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert not torch.equal(one["unattributed L, curve"], other["unattributed L, curve"])


def test_noise_on_short_flights_is_no_more_than_chance():
    """Linear terms take much of what is slow on short flights, of turned residuals as of the residual itself."""
    alarms = 0
    short = shorter(left("L", None), 6.0)
    for seed in range(20):
        noise = torch.randn(len(short.time) + 8, 6, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        residuals = Residuals(replace(short, residual=noise.unfold(0, 9, 1).mean(-1)))
        observed = {key: one.statistic for key, one in residuals.descriptions().items()}
        alarms += min(Draws(residuals.by_chance(19, seed)).adjusted_p(observed).values()) <= SETTINGS.level
    assert alarms <= 3  # 5 % of 20, and twice the scatter of that


def test_columns_hold_products_curves_and_onsets():
    names, (columns,) = Residuals(left("L", None)).columns()
    assert columns.shape == (len(TIME), len(names))
    assert len(set(names)) == len(names)
    curves = [one for one in names if Shape.of(one) is Shape.CURVE]
    assert len(curves) == len(NAMES) * (len(NAMES) - 1) // 2 + 3 * len(NAMES)
    torch.testing.assert_close(columns[:, names.index(("p col", "by their product", None))], P * COL)
    torch.testing.assert_close(columns[:, names.index(("col", "", 6.0))], COL * after(6.0))
