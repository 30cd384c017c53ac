"""What a multirotor's model leaves over is described by equation, signal and time, and judges what was named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
import torch

from rotorid_torch.core.least_squares import least_squares
from rotorid_torch.data.flight import Flight
from rotorid_torch.trace.evidence.critical_values import Draws, Null
from rotorid_torch.trace.evidence.family import Family
from rotorid_torch.trace.evidence.fits import Flights
from rotorid_torch.trace.evidence.unattributed import Residuals
from rotorid_torch.trace.loop import Tracing, _both, trace
from rotorid_torch.trace.measured.accelerations import MeasuredAccelerations
from rotorid_torch.trace.measured.fitted import FittedAtStates
from rotorid_torch.trace.measured.left_over import residuals_at_states
from rotorid_torch.trace.measured.measured_family import measured_family
from rotorid_torch.trace.terms.finding import Unknown
from tests.trace.test_multirotor import DRAG, LAG, fitted

ONSET, PUSH = 5.0, 1.5


def left(model: FittedAtStates) -> Residuals:
    residuals = residuals_at_states(model)
    assert residuals is not None
    return residuals


def pushed(flight: Flight) -> Flight:
    """A flight whose accelerometer feels a push down from a time on."""
    push = PUSH * (flight.time >= flight.time[0] + ONSET)
    return replace(flight, channels={**flight.channels, "az": flight.channels["az"] + push})


def test_the_model_takes_up_what_its_parameters_and_a_line_of_each_flight_do():
    """Against least squares of the columns themselves."""
    over = left(fitted(DRAG)).fitted
    k, chance = over.rows.index("X"), torch.Generator().manual_seed(0)
    wanted = torch.randn(len(over.time), 2, generator=chance, dtype=torch.float64)
    taken = torch.cat([over.constants, over.named[:, k]], dim=1)
    expected = wanted - taken @ least_squares(taken, wanted)
    torch.testing.assert_close(over.beyond(wanted, k), expected, rtol=1e-6, atol=1e-8)
    slopes = over.beyond(over.time[:, None], k)
    assert float(slopes.abs().max()) < 1e-8


def test_drag_that_has_no_name_goes_with_the_velocity_along_its_axis():
    described = left(fitted(DRAG)).descriptions()
    assert [described[f"unattributed {row}, curve"].regressor.signal.split()[0] for row in "XY"] == ["u", "v"]
    named = measured_family(fitted(DRAG), [DRAG])
    assert named.statistics["unattributed X, curve"] == pytest.approx(described["unattributed X, curve"].statistic)


def blown() -> Flights:
    """Flights of a vehicle with a lag of the motors, all of them pushed from the same time on."""
    flights = fitted(LAG).flights
    pushes = {name: pushed(flight) for name, flight in flights.dataset.flights.items()}
    return replace(flights, dataset=replace(flights.dataset, flights=pushes))


def test_what_begins_in_flight_is_described_by_its_time():
    model = fitted(LAG)
    step = left(replace(model, flights=blown())).descriptions()["unattributed Z, step"]
    assert step.regressor.signal == "time"
    assert step.regressor.since_s == pytest.approx(ONSET, abs=0.5)
    assert step.statistic > 0.1


def test_a_level_that_changes_as_motors_and_batteries_let_it_is_no_step():
    """By 1 % of gravity, with noise that is far smaller."""
    over = left(replace(fitted(LAG), flights=blown()))
    push = over.fitted.residual[:, over.fitted.rows.index("Z")]
    push *= 0.1 / PUSH
    assert over.descriptions()["unattributed Z, step"].statistic == 0.0


def test_what_has_no_name_is_unknown_beside_a_name_where_clean_vehicles_tell_how_much_is_ordinary():
    """Residuals of calm flights, turned in time, take the part of clean vehicles."""
    calm, flights = fitted(LAG), blown()
    scored = MeasuredAccelerations(calm.flights)
    null = MeasuredAccelerations(flights).fitted(calm.spec)

    def traced(clean: bool) -> Tracing:
        def draw(_: Null, tested: Sequence[str], observed: Family[FittedAtStates]) -> Draws:
            ordinary = scored.draws_by_chance(scored.family(calm, tested), tested, 0)
            return replace(ordinary, clean=clean, least=observed.least)

        return trace(Null(null.spec, null.values), flights, draw)

    unknown = traced(clean=True).unknown
    assert unknown is not None
    assert unknown.where == "Z"
    assert unknown.since_s == pytest.approx(ONSET, abs=0.5)
    assert traced(clean=False).unknown is None


def test_two_residuals_without_a_name_are_one_statement():
    one = Unknown("L", (0.1, 0.5), "v", None, "Something is missing in L.")
    other = Unknown("X", (0.2, 1.0), "u", 3.0, "Something is missing in X.")
    both = _both(one, other)
    assert (both.where, both.band_hz, both.goes_with) == ("LX", (0.1, 1.0), "v and u")
    assert both.sentence == "Something is missing in L. Something is missing in X."
    assert _both(None, other) is other
