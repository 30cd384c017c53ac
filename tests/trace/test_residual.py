"""What is left over is localised: with what it goes, since when, and in which equation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from rotorid_torch.core.names import FLAPPING, FORCES, MOMENTS, RATES, STICKS, VELOCITIES
from rotorid_torch.data import Dataset
from rotorid_torch.effects.spec import RotorSpec
from rotorid_torch.identification.reconstruct import reconstruct
from rotorid_torch.trace.floor import family_wise
from rotorid_torch.trace.residual import AT_ONCE, LeftOver, Trace, _moved, chance, left_over, scan
from rotorid_torch.trace.unexplained import unknown
from tests.known_models import BODY, body_spec, flown, linear_vehicle, manoeuvres, with_values

ROWS = ("X", "Y", "Z", "L", "M", "N")
NAMES = ("u", "p", "q", "col")
FLIGHTS, SAMPLES, STEP = 4, 240, 0.05


def left(row: str, extra: Tensor | None, noise: float = 0.05) -> LeftOver:
    chance = torch.Generator().manual_seed(1)
    made = torch.randn(FLIGHTS * SAMPLES, len(NAMES), generator=chance, dtype=torch.float64).cumsum(0)
    signals = made - made.view(FLIGHTS, SAMPLES, -1).mean(1).repeat_interleave(SAMPLES, 0)
    signals = signals / signals.std(0)
    residual = noise * torch.randn(len(signals), 6, generator=chance, dtype=torch.float64)
    if extra is not None:
        residual[:, ROWS.index(row)] += extra
    time = STEP * torch.arange(SAMPLES, dtype=torch.float64).repeat(FLIGHTS)
    own = torch.eye(FLIGHTS, dtype=torch.float64).repeat_interleave(SAMPLES, 0)
    linear, none = torch.cat([signals, own], dim=1), residual.new_zeros(*residual.shape, 0)
    return LeftOver(ROWS, residual, NAMES, signals, time, linear, signals[:, :0], own.argmax(dim=1), none)


def largest(traces: dict[str, Trace]) -> dict[str, Trace]:
    """Of each equation, whatever its kind."""
    return {trace.row: trace for trace in sorted(traces.values(), key=lambda trace: trace.size)}


def levels(rows: Sequence[str], floor: float) -> dict[str, float]:
    return {f"{row}, {kind}": floor for row in rows for kind in ("curve", "onset", "step")}


@pytest.fixture
def signals() -> Tensor:
    return left("L", None).signals


def test_a_model_has_its_values_back_where_a_moved_parameter_fails():
    model = linear_vehicle()
    before = model.theta.detach().clone()

    def failing() -> None:
        for _ in _moved(model, ["forces"]):
            raise ArithmeticError

    with pytest.raises(ArithmeticError):
        failing()
    assert torch.equal(model.theta.detach(), before)


def test_a_product_is_found_in_its_equation(signals: Tensor):
    found = scan(left("L", signals[:, 1] * signals[:, 3]))
    assert largest(found)["L"].goes_with == "p col"
    assert largest(found)["L"].since_s is None
    assert largest(found)["L"].size > 0.5
    assert max(largest(found)[row].size for row in ROWS if row != "L") < 0.05


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        (lambda x: torch.tanh(3.0 * x), "levelling off"),
        (lambda x: x * x.abs(), "growing faster than it"),
        (torch.square, "by its square"),
    ],
)
def test_a_curve_over_one_channel_is_told_by_the_channel_and_its_shape(signals: Tensor, shape, said: str):
    over = left("M", shape(signals[:, 2]))
    found = scan(over)
    assert (largest(found)["M"].goes_with, largest(found)["M"].shape, largest(found)["M"].since_s) == ("q", said, None)
    told = unknown(found, levels(ROWS, 0.05), over, over)
    assert told is not None
    assert f"go with q ({said})" in told.sentence


def test_what_begins_late_is_dated(signals: Tensor):
    time = STEP * torch.arange(SAMPLES, dtype=torch.float64).repeat(FLIGHTS)
    found = scan(left("M", signals[:, 2] * (time >= 6.0)))
    assert largest(found)["M"].goes_with == "q"
    assert largest(found)["M"].since_s == pytest.approx(6.0, abs=0.5)


@pytest.mark.parametrize(("step", "said"), [(1.0, "col and a step,"), (0.2, "col,"), (0.0, "col,")])
def test_a_control_that_slips_is_told_though_its_step_is_the_larger_part(signals: Tensor, step: float, said: str):
    after = (STEP * torch.arange(SAMPLES, dtype=torch.float64).repeat(FLIGHTS) >= 6.0).to(torch.float64)
    over = left("L", after * (step - 0.5 * signals[:, 3]), 0.3)
    told = unknown(scan(over), levels(ROWS, 0.05), over, over)
    assert told is not None
    assert (told.goes_with, told.since_s) == ("col", pytest.approx(6.0, abs=0.5))
    assert f"go with {said}" in told.sentence


def test_a_step_alone_goes_with_time(signals: Tensor):
    after = (STEP * torch.arange(SAMPLES, dtype=torch.float64).repeat(FLIGHTS) >= 6.0).to(torch.float64)
    over = left("L", after, 0.3)
    told = unknown(scan(over), levels(ROWS, 0.05), over, over)
    assert told is not None
    assert (told.goes_with, told.since_s) == ("time", 6.0)


def test_what_unseen_flights_do_not_show_beside_a_step_is_not_told(signals: Tensor):
    after = (STEP * torch.arange(SAMPLES, dtype=torch.float64).repeat(FLIGHTS) >= 6.0).to(torch.float64)
    over, unseen = left("L", after * (1.0 - 0.5 * signals[:, 3]), 0.3), left("L", after, 0.3)
    told = unknown(scan(over), levels(ROWS, 0.05), over, unseen)
    assert told is not None
    assert told.goes_with == "time"


def test_what_linear_terms_can_take_up_is_not_left_over(signals: Tensor):
    assert largest(scan(left("N", 3.0 * signals[:, 0])))["N"].size < 0.02


def test_below_the_floors_nothing_is_told_and_above_them_no_name(signals: Tensor):
    over = left("L", signals[:, 1] * signals[:, 3])
    found = scan(over)
    assert unknown(found, levels(ROWS, 1.5), over, over) is None
    assert unknown(found, {}, over, over) is None
    assert largest(found)["L"].weight == pytest.approx(largest(found)["L"].size, rel=0.05)
    told = unknown(found, levels(ROWS, 0.3), over, over)
    assert told is not None
    assert (told.where, told.goes_with) == ("L", "p col")
    assert told.band_hz[0] < told.band_hz[1]


def test_what_unseen_flights_do_not_show_is_not_told(signals: Tensor):
    product = signals[:, 1] * signals[:, 3]
    over = left("L", product)
    told = unknown(scan(over), levels(ROWS, 0.3), over, left("L", 0.8 * product))
    assert told is not None
    for other in (left("L", None), left("L", -product), left("L", product, noise=3.0), left("L", product, noise=60.0)):
        assert unknown(scan(over), levels(ROWS, 0.3), over, other) is None


def test_unseen_flights_that_excite_it_less_confirm_as_much_as_they_can(signals: Tensor):
    product = signals[:, 1] * signals[:, 3]
    over = left("L", product, noise=0.4)
    rest = left("L", None, noise=0.4)

    def unseen(size: float, motion: float = 0.5) -> LeftOver:
        residual, calm = rest.residual.flip(0), motion * signals
        residual[:, ROWS.index("L")] += size * calm[:, 1] * calm[:, 3]
        return replace(rest, signals=calm, residual=residual)

    told = unknown(scan(over), levels(ROWS, 0.3), over, unseen(1.0))
    assert told is not None
    assert (told.where, told.goes_with) == ("L", "p col")
    too_calm = unseen(1.0, motion=0.35)  # it is less than a tenth of all there
    for other in (unseen(0.0), unseen(-1.0), unseen(0.3), too_calm):
        assert unknown(scan(over), levels(ROWS, 0.3), over, other) is None


@pytest.mark.parametrize(("noise", "told"), [(1.2, True), (4.0, False)])
def test_one_of_many_imperfections_is_not_what_is_missing(signals: Tensor, noise: float, told: bool):
    over = left("L", signals[:, 1] * signals[:, 3], noise)
    found = scan(over)
    assert (largest(found)["L"].goes_with, largest(found)["L"].share > 0.2) == ("p col", told)
    assert (unknown(found, levels(ROWS, 0.1), over, over) is not None) == told


def test_what_begins_after_the_end_of_unseen_flights_cannot_be_told(signals: Tensor):
    time = STEP * torch.arange(SAMPLES, dtype=torch.float64).repeat(FLIGHTS)
    over = left("M", signals[:, 2] * (time >= 6.0))
    early = over.time < 5.0
    kept = {n: getattr(over, n)[early] for n in ("residual", "signals", "time", "linear", "tilts", "flight", "named")}
    short = replace(over, **kept)
    assert unknown(scan(over), levels(ROWS, 0.1), over, short) is None


def test_flights_too_short_to_have_a_middle_have_no_onset(signals: Tensor):
    over = left("M", signals[:, 1] * signals[:, 2])
    early = over.time < 3.0
    kept = {n: getattr(over, n)[early] for n in ("residual", "signals", "time", "linear", "tilts", "flight", "named")}
    assert largest(scan(replace(over, **kept)))["M"].goes_with == "p q"


def test_what_another_size_of_a_named_effect_explains_is_not_left_over(signals: Tensor):
    product = signals[:, 1] * signals[:, 3]
    over = left("L", product)
    change = torch.zeros_like(over.residual)[..., None]
    change[:, ROWS.index("L"), 0] = 0.1 * product
    assert largest(scan(over))["L"].size > 0.5
    assert largest(scan(replace(over, named=change)))["L"].size < 0.05


def test_chance_reaches_what_nothing_explains_and_falls_short_of_what_something_does(signals: Tensor):
    nothing, over = left("L", None), left("L", 0.2 * signals[:, 1] * signals[:, 3])
    level = {key: float(weights.quantile(0.99)) for key, weights in chance(nothing, 0).items()}
    assert all(trace.weight < 1.5 * level[key] for key, trace in scan(nothing).items())
    best = largest(scan(over))["L"]
    assert best.weight > float(chance(over, 0)[best.key].max())
    assert all(torch.equal(a, b) for a, b in zip(chance(over, 3).values(), chance(over, 3).values(), strict=True))


def test_a_step_is_told_below_what_curves_ordinary_aircraft_leave_over(signals: Tensor):
    """Each kind has a floor of its own: a louder curve that is ordinary does not hide what begins in the flights."""
    over = left("L", None)
    step = 0.5 * (over.time >= 6.0).to(torch.float64)
    both = replace(over, residual=over.residual + (step + 0.5 * signals[:, 1] * signals[:, 3])[:, None])
    found, floors = scan(both), levels(ROWS, 0.05)
    assert largest(found)["L"].goes_with == "p col"
    told = unknown(found, {key: 0.05 if key.endswith("step") else 1.0 for key in floors}, both, both)
    assert told is not None
    assert (told.goes_with, told.since_s) == ("time", 6.0)
    told = unknown(found, floors, both, both)
    assert told is not None
    assert told.goes_with == "p col"


def test_of_moments_that_say_the_same_the_largest_is_told(signals: Tensor):
    """A force behind and above the centre of gravity yaws the body most, but the lighter roll answers louder."""
    over = left("L", 2.0 * signals[:, 1] * signals[:, 3])
    residual = over.residual.clone()
    residual[:, ROWS.index("N")] += signals[:, 1] * signals[:, 3]
    both = replace(over, residual=residual)
    declared = replace(both, inertia=torch.tensor([1e3, 5e3, 4e3], dtype=torch.float64))
    for known, where in ((both, "L"), (declared, "N")):
        told = unknown(scan(known), levels(ROWS, 0.3), known, known)
        assert told is not None
        assert (told.where, told.goes_with) == (where, "p col")


@pytest.mark.parametrize("lost", [0.5, 0.1])
def test_a_moment_with_much_else_in_it_is_told_where_a_lighter_axis_shows_the_same(signals: Tensor, lost: float):
    """A pedal that slips yaws the body, where gusts hide it, and rolls it a little, where they do not.

    Of a small part that is lost the yawing moment shows the step alone.
    """
    over = left("L", None)
    slip = (over.time >= 6.0).to(torch.float64) * (1.0 - lost * signals[:, 3])
    residual = over.residual.clone()
    residual[:, ROWS.index("L")] += 1.5 * slip
    gusts = torch.randn(len(slip), generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    residual[:, ROWS.index("N")] += slip + 1.2 * gusts
    both = replace(over, residual=residual, inertia=torch.tensor([1e3, 5e3, 4e3], dtype=torch.float64))
    found = scan(both)
    assert found["N, step"].share < 0.2
    told = unknown(found, levels(ROWS, 0.05), both, both)
    assert told is not None
    assert (told.where, told.goes_with, told.since_s) == ("N", "col", 6.0)


def test_what_linear_terms_take_up_is_hardly_chance(signals: Tensor):
    over = left("L", None)
    much = over.residual.clone()
    much[:, ROWS.index("L")] += 9.0 * signals[:, 1]
    assert float(chance(replace(over, residual=much), 0)["L, curve"].max()) < 0.01


def test_noise_on_one_short_flight_is_no_more_than_chance():
    """Linear terms take much of what is slow on a short flight, of turned residuals as of the residual itself."""
    short, above = left("L", None), 0
    first = short.flight == 0
    for seed in range(20):
        noise = torch.randn(int(first.sum()) + 8, 6, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        smooth = noise.unfold(0, 9, 1).mean(-1)
        cut = {n: getattr(short, n)[first] for n in ("signals", "time", "tilts", "flight", "named")}
        linear = torch.cat([cut["signals"], torch.ones_like(smooth[:, :1])], dim=1)
        one = replace(short, **cut, residual=smooth, linear=linear)
        levels = family_wise(chance(one, seed))
        above += any(trace.weight > levels[key] for key, trace in scan(one).items())
    assert above <= 3  # 5 % of 20, and twice the scatter of that


@pytest.mark.parametrize(("noise", "where"), [(1.2, "N"), (0.05, "L")])
def test_another_axis_is_told_only_where_unseen_flights_confirm_it(signals: Tensor, noise: float, where: str):
    over = left("L", signals[:, 1] * signals[:, 3])
    declared = replace(over, inertia=torch.tensor([1e3, 5e3, 4e3], dtype=torch.float64))
    gusts = noise * torch.randn(len(signals), generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    residual = over.residual.clone()
    residual[:, ROWS.index("N")] += gusts + 0.5 * signals[:, 1] * signals[:, 3]
    seen = replace(declared, residual=residual)
    unseen = seen if where == "N" else declared
    told = unknown(scan(seen), levels(ROWS, 0.3), seen, unseen)
    assert told is not None
    assert told.where == where


def test_a_slip_between_two_of_the_times_that_are_tried_is_told_by_its_control(signals: Tensor):
    over = left("L", None)
    after = (over.time >= 6.2).to(torch.float64)
    slip = replace(over, residual=over.residual + (after * (2.0 - 0.5 * signals[:, 3]))[:, None])
    told = unknown(scan(slip), levels(ROWS, 0.05), slip, slip)
    assert told is not None
    assert (told.goes_with, told.since_s) == ("col", pytest.approx(6.2, abs=0.5))


def _both_ways(found: dict[str, Trace]) -> tuple[list[tuple[str, Trace]], list[tuple[str, Trace]]]:
    return [*found.items()], [*found.items()][::-1]


def test_a_disc_that_follows_at_once_does_not_take_up_by_its_own_tilt_what_moves_it(signals: Tensor):
    """Half of p's part in it is lost from 6 s on; a coning whose law is wrong in the tilt says the same, and louder."""
    over = left("L", None)
    tilt = signals[:, 1] * torch.where(over.time >= 6.0, 0.5, 1.0) + 0.3 * signals[:, 3]
    lost = (tilt - signals[:, 1])[:, None]
    residual = torch.cat([over.residual, lost, 9.0 * lost, lost], dim=1)
    disc = replace(
        over,
        rows=(*ROWS, "b1", "a0 at once", "b1 at once"),
        residual=residual,
        tilts=torch.stack([0.1 * tilt + signals[:, 0], signals[:, 2], tilt], dim=-1),  # a0, a1, b1
        named=residual.new_zeros(*residual.shape, 0),
    )
    found = scan(disc)
    assert largest(found)["b1"].size < 0.01
    assert (largest(found)["b1 at once"].goes_with, largest(found)["b1 at once"].since_s) == ("p", 6.0)
    assert largest(found)["b1 at once"].share > 0.9
    told = unknown(found, levels(disc.rows, 0.1), disc, disc)
    assert told is not None
    assert (told.where, told.goes_with, told.since_s) == ("b1", "p", 6.0)
    # what the disc's own angles cannot take up is surer
    surer = replace(
        disc, residual=torch.cat([residual[:, :6], (signals[:, 1] * signals[:, 3])[:, None], residual[:, 7:]], dim=1)
    )
    told = unknown(scan(surer), levels(disc.rows, 0.1), surer, surer)
    assert told is not None
    assert (told.where, told.goes_with) == ("b1", "p col")
    # one equation read twice that says the same is told as the surer reading, in whichever order
    twice = torch.cat([residual[:, :6], 0.2 * lost + 0.1 * over.residual[:, :1], residual[:, 7:]], dim=1)
    both = replace(disc, residual=twice, tilts=signals[:, [0, 2, 1]])  # its own p is no more than linear
    once = [unknown(dict(rows), levels(disc.rows, 0.01), both, both) for rows in _both_ways(scan(both))]
    assert once[0] is not None
    assert (once[0].where, once[0].goes_with) == ("b1", "p")
    assert once[0] == once[1]
    # nor does an angle that goes with something else, however much, stand for another
    product = (signals[:, 1] * signals[:, 3])[:, None]
    more = replace(disc, residual=torch.cat([residual[:, :7], 9.0 * product, 0.2 * lost], dim=1))
    told = unknown(scan(more), levels(disc.rows, 0.05), more, more)
    assert told is not None
    assert (told.where, told.goes_with) == ("a0", "p col")


def test_where_a_controller_holds_the_disc_the_angle_is_told_that_is_moved_most(signals: Tensor):
    """What is left of a step in the measured angles is chance, and a coning takes part in what tilts the disc."""
    over = left("L", None)
    step = (over.time >= 6.0).to(torch.float64)[:, None]
    residual = torch.cat([over.residual, 0.5 * step + over.residual[:, :1], step], dim=1)
    disc = replace(
        over,
        rows=(*ROWS, "a0 at once", "b1 at once"),
        residual=residual,
        tilts=signals[:, [0, 2, 1]] + torch.cat([0.02 * step, 0.0 * step, 0.0 * step], dim=1),
        named=residual.new_zeros(*residual.shape, 0),
    )
    told = unknown(scan(disc), levels(disc.rows, 0.1), disc, disc)
    assert told is not None
    assert (told.where, told.goes_with, told.since_s) == ("b1", "time", 6.0)


def test_a_mean_that_is_another_at_rest_than_in_motion_is_no_step():
    """What grows with the square of the motion has one, in every flight from the first input on."""
    model = linear_vehicle()
    data = flown(model, manoeuvres(12.0, 0.02), 0.02, noise=0.005)
    over = left_over(model, data, reconstruct(data), data.identify)
    rest = torch.tensor([0.02 * data.quiet(name) for name in data.identify], dtype=torch.float64)[over.flight]
    assert 0.5 < float(rest.min()) < 4.0
    lifted = replace(over, residual=over.residual + 0.1 * (over.time < rest)[:, None])
    assert largest(scan(lifted))["Y"].size < 0.02
    slipped = replace(over, residual=over.residual + 0.1 * (over.time < 6.0)[:, None])
    told = scan(slipped)["Y, step"]
    assert (told.since_s, told.size > 0.03) == (6.0, True)


def test_a_drift_is_no_step(signals: Tensor):
    """A line in time looks like a step in its middle; a step looks less like a line."""
    over = left("Y", None)
    for made, told in ((0.03 * over.time, False), (0.2 * (over.time >= 6.0), True)):
        drifting = replace(over, residual=over.residual + made[:, None] * (torch.arange(6) == 1))
        traces = scan(drifting)
        assert traces["Y, step"].share > 0.3
        found = unknown({"Y, step": traces["Y, step"]}, levels(ROWS, 0.01), drifting, drifting)
        assert (found is not None) is told


@pytest.mark.parametrize("order", [1, 2])
def test_a_slipped_control_run_shows_in_the_flapping_that_follows_it(order: int):
    """Half of the lateral cyclic's deviation is lost from 5 s on; the moments follow the measured flapping.

    A model with second-order flapping takes the measured rates as its own: still they show what its drivers lack.
    """
    columns = (*VELOCITIES, *RATES, *STICKS, *FLAPPING)
    patterns = dict.fromkeys((*FORCES, *MOMENTS, *FLAPPING), columns)
    reference = {**body_spec().reference, **dict.fromkeys(FLAPPING, 0.0)}
    outputs = (*BODY, "ax", "ay", "az", *FLAPPING)
    kind = {"flapping": "first order", "patterns": patterns, "reference": reference, "outputs": outputs}
    model = linear_vehicle(**kind)
    tilts = {f"rotor.{n}.{n}": -8.0 for n in FLAPPING} | {"rotor.a1.lon": 8.0, "rotor.b1.lat": 8.0, "rotor.a0.col": 4.0}
    hubs = {"forces.L.lat": 0.0, "forces.L.b1": 30.0, "forces.M.lon": 0.0, "forces.M.a1": 15.0}
    with_values(model, {**tilts, **hubs})
    asked = manoeuvres(12.0, 0.02)
    late = 0.02 * np.arange(len(asked["f_lat"])) >= 5.0
    asked = {n: c + 0.02 * np.sin(0.05 * np.arange(len(c)))[:, None] for n, c in asked.items()}
    came = {n: np.where(late[:, None] & (np.arange(4) == STICKS.index("lat")), 0.5 * c, c) for n, c in asked.items()}
    data = flown(model, came, 0.02, noise=0.005)
    asked_for = {n: {**f.channels, "lat": asked[n][:, STICKS.index("lat")]} for n, f in data.flights.items()}
    data = Dataset.from_arrays(asked_for, identify=data.identify, channels=data.channel_specs)
    if order == 2:
        rotor = RotorSpec(speed=27.0, blades=4, radius=8.0, chord=0.5)
        richer = linear_vehicle(**kind, rotor=rotor, effects=("rotor.flap_second_order",))
        model = with_values(richer, {**model.named_values, "rotor.flap_second_order.share": 1.0})
    over = left_over(model, data, reconstruct(data), data.identify)
    assert over.rows == (*ROWS, *FLAPPING, *AT_ONCE)
    found = scan(over)
    assert (largest(found)["b1"].goes_with, largest(found)["b1"].since_s) == ("lat", pytest.approx(5.0, abs=0.5))
    assert largest(found)["b1"].share > 0.5
    assert largest(found)["L"].size < 0.1 * largest(found)["b1"].size * 30.0
    some = {n: {c: v for c, v in f.items() if n != "f_ped" or c not in FLAPPING} for n, f in asked_for.items()}
    lacking = Dataset.from_arrays(some, identify=data.identify, channels=data.channel_specs)
    partly = left_over(model, lacking, reconstruct(lacking), data.identify)
    again = scan(partly)
    assert (largest(again)["b1"].goes_with, largest(again)["b1"].since_s) == ("lat", pytest.approx(5.0, abs=0.5))
    assert largest(again)["L"].size < 0.1 * largest(again)["b1"].size * 30.0
    low, tilting = levels(over.rows, 1e-3), {key: trace for key, trace in found.items() if trace.row == "b1"}
    for unseen in (over, partly):  # a flight whose disc nobody saw speaks neither for it nor against it
        told = unknown(tilting, low, over, unseen)
        assert told is not None
        assert told.where == "b1"
    bare = {n: {c: v for c, v in f.items() if c not in FLAPPING} for n, f in asked_for.items()}
    blind = Dataset.from_arrays(bare, identify=data.identify, channels=data.channel_specs)
    assert unknown(tilting, low, over, left_over(model, blind, reconstruct(blind), data.identify)) is None
