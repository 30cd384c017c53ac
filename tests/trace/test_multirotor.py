"""The search at measured states: what acts joins, what does not act does not, and clean vehicles show nothing."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from functools import cache

import pytest
import torch

from rotorid_torch.data import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.one_rate import at_one_rate
from rotorid_torch.effects.examples import HELICOPTER, MULTIROTOR
from rotorid_torch.effects.registry import registered
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.simulation import fly
from rotorid_torch.simulation.drawn.multirotors import clean_multirotors
from rotorid_torch.simulation.multirotor.vehicles import multirotor
from rotorid_torch.trace import loop
from rotorid_torch.trace.clean_aircraft import statistics_on
from rotorid_torch.trace.evidence.critical_values import Null
from rotorid_torch.trace.evidence.fits import Flights
from rotorid_torch.trace.loop import Tracing, trace
from rotorid_torch.trace.measured.accelerations import MeasuredAccelerations
from rotorid_torch.trace.measured.fitted import FittedAtStates
from rotorid_torch.trace.measured.measured_family import measured_family
from rotorid_torch.trace.search.eligible import candidates
from rotorid_torch.trace.search.requested import earned
from rotorid_torch.trace.terms.candidate import Candidate
from rotorid_torch.trace.terms.finding import EffectFinding

DELAY, LAG, INERTIA = "control.delay", "propulsion.motor_lag", "propulsion.rotor_inertia"
DRAG, INFLOW = "propulsion.rotor_drag", "propulsion.axial_inflow"
WIND, BODY = "environment.wind", "forces.drag"
FLIGHTS = ("roll_p", "pitch_p", "eight_p", "mixed_n")
FAST = ["fast_p", "fast_q", "eight_p", "eight_n"]


@cache
def hidden(*effects: str) -> Dataset:
    """Flights of a drawn quadrotor whose model shares no equation with the identification's."""
    made = fly(None, vehicle="multirotor-2", flights=list(FLIGHTS), effects=[(e, 1.0) for e in effects], seconds=10.0)
    return at_one_rate(made.dataset())


@cache
def fitted(*effects: str, alone: bool = False) -> FittedAtStates:
    """The nominal model on these flights, or on one of them alone."""
    data = hidden(*effects)
    data = replace(data, identify=("eight_p",), validate=(), acid=()) if alone else data
    flights = Flights(data, reconstruct(data))
    return FittedAtStates.of(propose(data, flights.reconstruction, ()), flights)


@cache
def traced(*effects: str) -> Tracing:
    null = fitted(*effects)
    return trace(Null(null.spec, null.values), null.flights, lambda null, tested, observed: "none drawn")


def test_what_acts_joins_with_its_size_and_what_does_not_act_does_not():
    tracing = traced(LAG, DRAG)
    assert DRAG in tracing.accepted
    named = {e for f in tracing.findings if f.id in tracing.accepted for e in (f.id, *f.group)}
    assert LAG in named  # or a delay
    verdicts = {f.id: f for f in tracing.findings}
    assert verdicts[DRAG].verdict == "accepted"
    assert verdicts[DRAG].smallest_visible is not None
    assert verdicts[INERTIA].verdict in ("below floor", "rejected", "indistinguishable")
    assert tracing.notes[0].endswith("stand in another order: none drawn")
    assert len(tracing.accepted) > 1
    assert any(", and none with " in note for note in tracing.notes[1:])  # the least beside the others


def test_where_nothing_is_hidden_nothing_joins():
    assert traced().accepted == ()


def test_a_size_is_told_by_flights_that_did_not_give_it():
    """The evidence of the drag is that of the forces along both axes; of what does not act there is none."""
    family = measured_family(fitted(DRAG), [DRAG, LAG, INERTIA])
    assert family.statistics[DRAG] > 0.1
    assert family.statistics[INERTIA] < 0.01 * family.statistics[DRAG]
    turned = measured_family(fitted(DRAG), [DRAG], turned=5)
    assert max(float(turned.screen.evidence(DRAG, 1 + k).sum()) for k in range(5)) < 0.05 * family.statistics[DRAG]


def test_one_flight_alone_is_its_own_witness_in_halves():
    assert measured_family(fitted(DRAG, alone=True), [DRAG]).statistics[DRAG] > 0.05


def blown(vehicle: str, speed: float) -> tuple[MeasuredAccelerations, FittedAtStates]:
    """Flights on four headings in a wind, and their model with the wind and drag of the rotors alone."""
    headings = ["hover_p", "hover_p-120deg", "eight_p", "eight_n-270deg"]
    winds = [(WIND, speed / multirotor(vehicle).speed)]
    data = at_one_rate(fly(None, vehicle=vehicle, flights=headings, effects=winds, seconds=8.0).dataset())
    flights = Flights(data, reconstruct(data))
    drag = propose(data, flights.reconstruction, (DRAG,))
    null = FittedAtStates.of(FittedAtStates.of(drag, flights).started(drag.with_effects(WIND)), flights)
    return MeasuredAccelerations(flights), null


def test_a_wind_of_one_heading_is_seen_with_the_drag_through_which_it_acts():
    """Without drag there is no wind to feel, and drag about still air is the wrong one."""
    winds = [(WIND, 8.0 / multirotor("quad").speed)]
    tunnel = ["hover_p", "roll_p", "pitch_p", "thrust_p", "mixed_n"]
    data = at_one_rate(fly(None, vehicle="quad", flights=tunnel, effects=winds, seconds=8.0).dataset())
    flights = Flights(data, reconstruct(data))
    null, scored = FittedAtStates.of(propose(data, flights.reconstruction, ()), flights), MeasuredAccelerations(flights)
    assert scored.family(null, [WIND, DRAG]).statistics[WIND] <= 0.0
    scored.fit_ahead(null, [WIND, DRAG], ())
    observed = scored.family(null, [WIND, DRAG])
    assert observed.statistics[WIND] > 0.5
    whole = scored.candidates(null, observed, [Candidate(WIND)])[Candidate(WIND)]
    assert whole.spec.effects == (DRAG, WIND)
    found = complex(whole.values[f"{WIND}.north"], whole.values[f"{WIND}.east"])
    assert abs(found) == pytest.approx(8.0, rel=0.2)  # not to say from where: thrust by speed is not in the model


def test_a_fit_ahead_shows_loss_by_climbing_that_a_line_does_not():
    """Beside the wind whose lift cancels it."""
    scored, null = blown("multirotor-1", 8.0)
    line = scored.family(null, [INFLOW], (DRAG, WIND)).statistics[INFLOW]
    scored.fit_ahead(null, [INFLOW], (DRAG, WIND))
    assert scored.family(null, [INFLOW], (DRAG, WIND)).statistics[INFLOW] > max(0.2, 2.0 * line)


def test_loss_by_climbing_is_seen_beside_the_wind_whose_lift_cancels_it():
    """And no drag of the body with it."""
    speed = 8.0
    scored, null = blown("quad", speed)
    scored.fit_ahead(null, [INFLOW], (DRAG, WIND))
    observed = scored.family(null, [INFLOW], (DRAG, WIND))
    assert observed.statistics[INFLOW] > 0.2
    whole = scored.candidates(null, observed, [Candidate(INFLOW)])[Candidate(INFLOW)]
    found = complex(whole.values[f"{WIND}.north"], whole.values[f"{WIND}.east"])
    assert abs(found + speed * cmath.rect(1.0, math.radians(40.0))) < 0.05 * speed
    body = scored.candidates(whole, observed, [Candidate(BODY)])[Candidate(BODY)]
    assert all(body.sigma[row] > 0.98 * whole.sigma[row] for row in ("ax", "ay"))


def test_clean_vehicles_in_the_likeness_of_the_data_show_none_of_it():
    null = fitted(LAG, DRAG)
    observed = measured_family(null, [LAG, DRAG]).statistics
    for clean in clean_multirotors(hidden(LAG, DRAG), 0, (0, 1)):
        drawn = statistics_on(clean.dataset, Null(null.spec, null.values), [LAG, DRAG])
        # commands that are faster than the record look late, on the data and on a clean vehicle alike
        assert drawn["statistics"][LAG] < 0.25 * observed[LAG]
        assert abs(drawn["sizes"][f"{LAG}.tau"]) < 0.02
        assert drawn["statistics"][DRAG] < 0.01 * observed[DRAG]


def test_a_moment_that_the_rotors_do_not_explain_takes_nothing_from_the_evidence():
    """Of a roll rate that is noise the null holds the moment at zero, and no lag lets the rotors explain that noise."""
    data, chance = hidden(LAG), torch.Generator().manual_seed(0)

    def disturbed(flight: Flight) -> Flight:
        noise = torch.randn(len(flight.time), generator=chance, dtype=torch.float64)
        return replace(flight, channels={**flight.channels, "p": noise})

    noisy = replace(data, flights={name: disturbed(flight) for name, flight in data.flights.items()})
    flights = Flights(noisy, reconstruct(noisy))
    null = FittedAtStates.of(propose(noisy, flights.reconstruction, ()), flights)
    assert "L" in null.silent
    left = measured_family(null, [LAG]).statistics[LAG]
    assert left > 0.5 * measured_family(fitted(LAG), [LAG]).statistics[LAG]


def test_a_lag_and_a_delay_are_two_causes_whichever_joins_first():
    """At the null each takes the place of the other; sizes that the null's parameters follow tell them apart."""
    tracing = traced(LAG, DELAY)
    assert {LAG, DELAY} <= set(tracing.accepted)
    assert tracing.final.values[f"{DELAY}.common"] > 0.01


def test_moments_that_are_held_at_zero_may_be_explained_with_a_candidate():
    null = fitted(LAG)
    silent = FittedAtStates(null.spec, null.model, null.flights, null.errors, null.without)
    with null.model.restored(), torch.no_grad():
        null.model.start_from({"rotors.power.L": 0.0})
        assert silent.silent == ("L",)
        assert not any(name.endswith(".L") for name in silent.started(null.spec).values)


def test_evidence_of_one_cause_does_not_hang_on_what_else_is_asked():
    """Beside moments that are held at zero: where only power times thrust counts a row tells no control power."""
    known, flapping = (DRAG, INFLOW), "propulsion.flapping"
    hidden_in_it = [(effect, 1.0) for effect in known]  # and discs that lean, as the air holds them
    made = fly(None, vehicle="quad", flights=FAST, effects=hidden_in_it, seconds=10.0, speed=12.0)
    data = at_one_rate(made.dataset())
    flights = Flights(data, reconstruct(data))
    null = FittedAtStates.of(propose(data, flights.reconstruction, known), flights)
    assert null.silent == ("L", "M")
    alone = measured_family(null, [flapping]).statistics[flapping]
    among = measured_family(null, [flapping, "mass.slung_load", LAG]).statistics[flapping]
    assert alone > 0.1
    assert math.isclose(among, alone, rel_tol=1e-3)


def test_an_effect_that_was_asked_for_earns_its_place_where_it_acts():
    shared = MeasuredAccelerations(fitted(DRAG).flights)
    whole = shared.fitted(fitted(DRAG).spec.with_effects(DRAG, INERTIA))
    findings = {f.id: f for f in earned(shared, whole, [DRAG, INERTIA])}
    assert findings[DRAG].verdict == "accepted", findings[DRAG].reason
    assert findings[INERTIA].verdict != "accepted"


def test_what_makes_no_sense_of_motor_commands_is_never_tried():
    """They pass no linkage and no actuator, have a lag of their own, and answer the rates."""
    testable, settled = candidates(MULTIROTOR)
    said = {f.id: (f.verdict, f.reason) for f in settled}
    for effect in ("control.lag", "control.backlash", "control.rate_limit", "forces.quadratic_damping"):
        assert effect not in testable
        assert said[effect][0] == "not testable"
        assert "commands" in said[effect][1]
    assert {DELAY, LAG} <= set(testable)
    assert {"control.lag", "control.backlash"} <= set(candidates(HELICOPTER)[0])


def test_a_controller_that_answers_noise_is_no_turbulence():
    settled = {f.id: f for f in candidates(MULTIROTOR)[1]}
    assert registered()["environment.turbulence"].untestable(MULTIROTOR)
    assert registered()["environment.turbulence"].untestable(HELICOPTER) is None
    assert "environment.turbulence" not in {*candidates(MULTIROTOR)[0], *settled}


def test_a_centre_of_gravity_that_balance_shows_is_said(monkeypatch: pytest.MonkeyPatch):
    shown = EffectFinding(
        "mass.cg", "undeclared", "indistinguishable", "it lies there", values={"mass.cg.x": (0.01, 0.001)}
    )
    monkeypatch.setattr(loop, "out_of_balance", lambda *of: (shown, None))
    assert [f for f in traced.__wrapped__().findings if f.id == "mass.cg"] == [shown]  # not what stays for the others


def test_absorbed_weights_are_not_asked_of_accelerations_and_no_load_is_named_where_none_hangs():
    verdicts = {f.id: f.verdict for f in traced().findings}
    assert verdicts["mass.slung_load"] in ("below floor", "rejected")
    assert verdicts["mass.payload"] == "indistinguishable"
