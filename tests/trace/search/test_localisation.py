"""Where what has no name lies: in which equation, with what it goes and how, since when. Never a name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import pytest
import torch
from scipy.signal import lsim
from torch import Tensor

from rotorid_torch.trace.evidence.residual import LeftOver, Regressor
from rotorid_torch.trace.evidence.unattributed import Description, Residuals
from rotorid_torch.trace.search.localisation import localised
from rotorid_torch.trace.terms.finding import Unknown
from rotorid_torch.trace.terms.settings import SETTINGS
from tests.trace.evidence.left_overs import COL, ROWS, SIGNALS, STEP, TIME, P, Q, U, after, left

INERTIA = torch.tensor([1e3, 5e3, 4e3], dtype=torch.float64)


def significant(
    residuals: Residuals, level: float, kinds: Sequence[str] = ("curve", "onset", "step")
) -> list[Description]:
    """Descriptions with a statistic above a level, as critical values of the family would be."""
    found = residuals.descriptions()
    return [one for key, one in found.items() if one.statistic > level and key.endswith(tuple(kinds))]


def told(over: LeftOver, unseen: LeftOver | None = None, level: float = 0.05) -> Unknown:
    residuals = Residuals(over, unseen)
    return localised(significant(residuals, level), residuals, {})


def with_rows(over: LeftOver, more: Mapping[str, Tensor], tilts: Tensor) -> LeftOver:
    """The same with equations of a disc [N] of measured angles [N, 3]."""
    residual = torch.cat([over.residual, torch.stack([*more.values()], dim=-1)], dim=1)
    named = residual.new_zeros(*residual.shape, 0)
    return replace(over, rows=(*ROWS, *more), residual=residual, tilts=tilts, named=named)


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        (lambda x: torch.tanh(3.0 * x), "levelling off"),
        (lambda x: x * x.abs(), "growing faster than it"),
        (torch.square, "by its square"),
    ],
)
def test_a_curve_over_one_channel_is_told_by_the_channel_and_its_shape(shape, said: str):
    found = told(left("M", shape(Q)))
    assert (found.where, found.goes_with, found.since_s) == ("M", "q", None)
    assert f"go with q ({said})" in found.sentence


def test_a_product_is_told_with_its_size_unit_and_band():
    period = 2.0 * torch.pi / 0.7
    wave = torch.sin(2.0 * torch.pi / period * TIME)  # slow beside the samples
    signals = SIGNALS.clone()
    signals[:, 3] = wave
    product = P * wave
    found = told(replace(left("L", product), signals=signals))
    assert (found.where, found.goes_with) == ("L", "p col")
    low, high = found.band_hz
    assert 0.0 <= low < high < 0.5 / STEP
    rms = float(product.square().mean().sqrt())
    size = float(found.sentence.split("missing in L: ")[1].split(" ")[0])
    assert size == pytest.approx(rms, rel=0.3)
    assert "rad/s2 rms" in found.sentence
    assert found.sentence.endswith("no effect of the library explains it.")


@pytest.mark.parametrize(("step", "said"), [(1.0, "col and a step,"), (0.2, "col,"), (0.0, "col,")])
def test_a_control_that_slips_is_told_though_its_step_is_the_larger_part(step: float, said: str):
    over = left("L", after(6.0) * (step - 0.5 * COL), 0.3)
    found = told(over, over)
    assert (found.goes_with, found.since_s) == ("col", pytest.approx(6.0, abs=0.5))
    assert f"go with {said}" in found.sentence


def test_a_step_alone_goes_with_time():
    over = left("L", after(6.0), 0.3)
    found = told(over, over)
    assert (found.goes_with, found.since_s) == ("time", 6.0)
    assert "since 6.0 s into the flights" in found.sentence


def test_what_unseen_flights_do_not_show_beside_a_step_is_not_told():
    over, unseen = left("L", after(6.0) * (1.0 - 0.3 * COL), 0.3), left("L", after(6.0), 0.3)
    assert told(over, over).goes_with == "col"
    assert told(over, left("L", after(6.0) * (1.0 + 0.3 * COL), 0.3)).goes_with == "time"
    assert told(over, unseen).where == "L"


def test_the_flight_and_the_time_of_the_largest_residual_are_told():
    """What goes with a signal all the time, and a burst of 0.25 s at 7 s of the third flight."""
    over = left("L", P * COL)
    burst = torch.exp(-0.5 * ((over.time - 7.0) / 0.25) ** 2) * (over.flight == 2)
    most = replace(over, residual=over.residual + 9.0 * burst[:, None], flights=("hover", "climb", "turn", "box"))
    assert "is at 7.0 s of turn." in told(most, over).sentence
    assert " of turn" not in told(over, over).sentence  # of flights without names


def test_a_slip_between_two_of_the_times_that_are_tried_is_told_by_its_control():
    over = left("L", None)
    slip = replace(over, residual=over.residual + (after(6.2) * (2.0 - 0.5 * COL))[:, None])
    found = told(slip, slip)
    assert (found.goes_with, found.since_s) == ("col", pytest.approx(6.2, abs=0.5))


def test_a_step_is_told_below_what_curves_ordinary_aircraft_leave_over():
    """Each kind is a member of its own: a louder curve that is ordinary does not hide what begins in the flights."""
    over = left("L", None)
    both = replace(over, residual=over.residual + (0.5 * after(6.0) + 0.5 * P * COL)[:, None])
    residuals = Residuals(both, both)
    found = localised(significant(residuals, 0.02, ("step",)), residuals, {})
    assert (found.goes_with, found.since_s) == ("time", 6.0)
    assert localised(significant(residuals, 0.02), residuals, {}).goes_with == "p col"


def test_of_moments_that_say_the_same_the_largest_is_told():
    """A force behind and above the centre of gravity yaws the body most, but the lighter roll answers louder."""
    over = left("L", 2.0 * P * COL)
    residual = over.residual.clone()
    residual[:, ROWS.index("N")] += P * COL
    both = replace(over, residual=residual)
    for known, where in ((both, "L"), (replace(both, inertia=INERTIA), "N")):
        found = told(known, known)
        assert (found.where, found.goes_with) == (where, "p col")


@pytest.mark.parametrize("lost", [0.5, 0.1])
def test_a_moment_with_much_else_in_it_is_told_where_a_lighter_axis_shows_the_same(lost: float):
    """A pedal that slips yaws the body, where gusts hide it, and rolls it a little, where they do not.

    Of a small part that is lost the yawing moment shows the step alone.
    """
    over = left("L", None)
    slip = after(6.0) * (1.0 - lost * COL)
    residual = over.residual.clone()
    residual[:, ROWS.index("L")] += 1.5 * slip
    gusts = torch.randn(len(slip), generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    residual[:, ROWS.index("N")] += slip + 1.2 * gusts
    both = replace(over, residual=residual, inertia=INERTIA)
    residuals = Residuals(both, both)
    roll = [one for one in significant(residuals, 0.05) if one.row == "L"]  # yaw is not significant by itself
    found = localised(roll, residuals, {})
    assert (found.where, found.goes_with, found.since_s) == ("N", "col", 6.0)


@pytest.mark.parametrize(("noise", "where"), [(1.2, "N"), (0.05, "L")])
def test_another_axis_is_told_only_where_unseen_flights_confirm_it(noise: float, where: str):
    over = left("L", P * COL)
    declared = replace(over, inertia=INERTIA)
    gusts = noise * torch.randn(len(P), generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    residual = over.residual.clone()
    residual[:, ROWS.index("N")] += gusts + 0.5 * P * COL
    seen = replace(declared, residual=residual)
    contrary = over.residual.clone()
    contrary[:, ROWS.index("N")] -= 0.5 * P * COL
    unseen = seen if where == "N" else replace(declared, residual=contrary)
    residuals = Residuals(seen, unseen)
    roll = [one for one in significant(residuals, 0.3) if one.row == "L"]
    assert localised(roll, residuals, {}).where == where


def test_an_axis_in_which_only_chance_says_the_same_is_hardly_told():
    """A part of the noise of a heavy axis goes with anything: no more often than the confidence of a t-test allows."""
    wrong, count = 0, 40
    for seed in range(count):
        over = left("L", P * COL, 0.3)
        noise = torch.randn(len(P), generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        residual = over.residual.clone()
        residual[:, ROWS.index("N")] = 3.0 * noise
        residuals = Residuals(replace(over, residual=residual, inertia=INERTIA * torch.tensor([1.0, 1.0, 20.0])))
        wrong += localised([residuals.of("L", Regressor("p col", "by their product"))], residuals, {}).where != "L"
    share = 1.0 - SETTINGS.confidence
    assert wrong / count < share + 2.0 * (share * (1.0 - share) / count) ** 0.5


def test_an_angle_in_which_only_chance_says_the_same_is_not_told():
    """The coning goes with the lateral stick in these flights, though what is left over is none of it."""
    over = left("L", None)
    disc = with_rows(over, {"a0": over.residual[:, 0], "b1": 0.5 * COL * after(6.0)}, torch.stack([COL, U, Q], dim=-1))
    found = told(disc, disc, 0.1)
    assert (found.where, found.goes_with) == ("b1", "col")


def disc_that_lost_a_part() -> tuple[LeftOver, LeftOver, Tensor]:
    """Half of p's part in a tilt is lost from 6 s on; a coning whose law is wrong in the tilt says the same, louder."""
    over = left("L", None)
    tilt = P * torch.where(TIME >= 6.0, 0.5, 1.0) + 0.3 * COL
    lost = tilt - P
    tilts = torch.stack([0.1 * tilt + U, Q, tilt], dim=-1)  # a0, a1, b1
    return over, with_rows(over, {"b1": lost, "a0 at once": 9.0 * lost, "b1 at once": lost}, tilts), lost


def test_a_disc_that_follows_at_once_does_not_take_up_by_its_own_tilt_what_moves_it():
    _, disc, _ = disc_that_lost_a_part()
    found = Residuals(disc).descriptions()
    assert max(one.statistic for one in found.values() if one.row == "b1") < 0.01
    best = max((one for one in found.values() if one.row == "b1 at once"), key=lambda one: one.statistic)
    assert (best.regressor.signal, best.regressor.since_s) == ("p", 6.0)
    answer = told(disc, disc, 0.1)
    assert (answer.where, answer.goes_with, answer.since_s) == ("b1", "p", 6.0)


def test_one_equation_read_twice_that_says_the_same_is_told_as_the_surer_reading_in_whichever_order():
    over, disc, lost = disc_that_lost_a_part()
    residual = torch.cat(
        [disc.residual[:, :6], (0.2 * lost + 0.1 * over.residual[:, 0])[:, None], disc.residual[:, 7:]], 1
    )
    both = replace(disc, residual=residual, tilts=SIGNALS[:, [0, 2, 1]])  # its own p is no more than linear
    residuals = Residuals(both, both)
    chosen = significant(residuals, 0.01)
    once, again = (localised(one, residuals, {}) for one in (chosen, chosen[::-1]))
    assert (once.where, once.goes_with) == ("b1", "p")
    assert once == again


def test_no_angle_that_goes_with_something_else_stands_for_another():
    """However much it goes with that."""
    _, disc, lost = disc_that_lost_a_part()
    residual = torch.cat([disc.residual[:, :7], (9.0 * P * COL)[:, None], (0.2 * lost)[:, None]], dim=1)
    more = replace(disc, residual=residual)
    found = told(more, more, 0.05)
    assert (found.where, found.goes_with) == ("a0", "p col")


def test_where_a_controller_holds_the_disc_the_angle_is_told_that_is_moved_most():
    """What is left of a step in the measured angles is chance, and a coning takes part in what tilts the disc."""
    over = left("L", None)
    step = after(6.0)
    tilts = SIGNALS[:, [0, 2, 1]] + torch.stack([0.02 * step, 0.0 * step, 0.0 * step], dim=-1)
    disc = with_rows(
        over, {"a0 at once": 0.5 * step + over.residual[:, 0], "b1 at once": step + over.residual[:, 1]}, tilts
    )
    found = told(disc, disc, 0.1)
    assert (found.where, found.goes_with, found.since_s) == ("b1", "time", 6.0)


def test_what_moves_the_disc_is_told_of_the_disc_though_the_body_shows_it_louder():
    over = left("L", 5.0 * P * COL)
    disc = with_rows(over, {"b1": 0.3 * P * COL}, SIGNALS[:, [0, 2, 1]])
    assert told(disc, disc).where == "b1"


@pytest.mark.parametrize("frequency", [0.6, 2.0])
def test_what_swings_by_itself_from_the_start_has_no_onset(frequency: float):
    """A mode that the model lacks, driven by the roll rate: its motion goes otherwise with the signals at any time."""
    over = left("L", None)
    before = [P[over.flight == f] for f in over.flight.unique()]
    swings = [_response(torch.cat([one.flip(0), one]), frequency, 0.05)[len(one) :] for one in before]
    swing = torch.cat(swings)
    swinging = left("L", swing / swing.std())
    residuals = Residuals(swinging, swinging)
    found = localised(significant(residuals, 0.02, ["onset"]), residuals, {})
    assert (found.where, found.since_s) == ("L", None)
    assert "since" not in found.sentence


@pytest.mark.parametrize("extra", [after(6.0) * P, after(6.0) * (P - 0.5 * COL), after(6.2) * (1.0 - 0.5 * COL)])
def test_what_begins_has_an_onset_whatever_begins_with_it(extra: Tensor):
    over = left("L", extra, 0.3)
    assert told(over, over, level=0.02).since_s == pytest.approx(6.0, abs=0.5)


def _response(force: Tensor, frequency: float, damping: float) -> Tensor:
    """Displacement [T] of an oscillator of this frequency, rad/s, that a force per mass [T] drives."""
    time = STEP * torch.arange(len(force), dtype=torch.float64)
    system = ([1.0], [1.0, 2.0 * damping * frequency, frequency**2])
    return torch.as_tensor(lsim(system, force.numpy(), time.numpy())[1])
