"""Moving air in the loop's findings, and no clean bill where there is no model."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from rotorid_torch.core.names import Verdict
from rotorid_torch.data import load
from rotorid_torch.data.one_rate import at_one_rate
from rotorid_torch.effects.examples import HELICOPTER
from rotorid_torch.identification.gusts import Air, GustAxis
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.report.summary import failing
from rotorid_torch.run.fit_record import judge
from rotorid_torch.run.free_runs import unfed_score
from rotorid_torch.run.turbulence import (
    ALIKE,
    Choice,
    in_turbulence,
    method_by_quiet_moments,
    without_clean_bill,
    without_what_gusts_leave,
)
from rotorid_torch.trace.evidence.critical_values import Null
from rotorid_torch.trace.loop import Tracing
from rotorid_torch.trace.terms.finding import EffectFinding, Unknown
from rotorid_torch.trace.terms.verdict import statement
from tests.consistency.pairs.test_velocity_clock import gliding
from tests.helpers import shared
from tests.known_models import flown, linear_vehicle, manoeuvres, rate_vehicle
from tests.run.test_close_loop import over, run_of

QUIET = EffectFinding(
    "environment.turbulence", "undeclared", "below floor", "before the pilot acts all flights are alike"
)
GUSTY = replace(QUIET, verdict="accepted")
WHY = "fitted by the filter error method: the air moves"


def air(*axes: GustAxis) -> Air:
    nothing = torch.zeros(1, 2, 3, dtype=torch.float64)
    return Air(axes, 5.0, 0.02, nothing, nothing, torch.zeros(0), torch.zeros(0), torch.zeros(3), torch.zeros(3))


def test_turbulence_is_named_with_intensity_and_length():
    axes = [GustAxis(n, 1.2, 0.12, 80.0, 20.0) for n in ("u", "v", "w")]
    found = in_turbulence(GUSTY, air(*axes), WHY)
    assert found.verdict == "accepted"
    intensity, length = (found.values[f"environment.turbulence.{n}"] for n in ("intensity", "length"))
    assert intensity == pytest.approx((1.2, 0.12 / math.sqrt(3.0)))
    assert length == pytest.approx((80.0, 20.0 / math.sqrt(3.0)))
    assert statement([found], None).sentence.startswith(
        "Undeclared: environment.turbulence (intensity 1.2 ± 0.07, length 80 ± 10)"
    )


def test_a_length_that_is_not_told_is_not_said():
    found = in_turbulence(GUSTY, air(GustAxis("u", 1.0, 0.1, 20.0, math.inf)), WHY)
    assert set(found.values) == {"environment.turbulence.intensity"}


@pytest.mark.parametrize(("verdict", "stays"), [("accepted", False), ("below floor", True)])
def test_what_gusts_leave_over_is_nothing_missing(verdict: Verdict, stays: bool):
    missing = Unknown("M", (0.1, 2.0), "v", None, "Something is missing in M.")
    model = Null(HELICOPTER, {})
    tracing = Tracing(model, model, (), (), (), unknown=missing)
    after = without_what_gusts_leave(tracing, [replace(QUIET, verdict=verdict)])
    assert (after.unknown == missing) is stays


def test_turbulence_that_no_quiet_moments_show_is_suspected_with_its_size():
    found = in_turbulence(QUIET, air(*(GustAxis(n, 1.2, 0.12, 80.0, 20.0) for n in ("u", "v", "w"))), WHY)
    assert (found.verdict, found.reason.startswith(WHY)) == ("suspected", True)
    assert statement([found], None).kind == "unknown"
    assert "environment.turbulence (intensity 1.2 ± 0.07" in statement([found], None).sentence


@pytest.mark.parametrize(
    ("moving", "calm", "better"), [(0.3, 0.4, 0.3), (0.4, 0.3, 0.3), (None, 0.9, 0.9), (0.3, None, 0.3)]
)
def test_free_runs_of_unseen_flights_choose_the_method_without_gusts_fed_in(
    moving: float | None, calm: float | None, better: float
):
    runs = [run_of(over("validate", [J]) | over("identify", [0.1])) for J in (calm, moving)]
    assert min(runs, key=unfed_score).scores["validate"] == better


def test_calm_air_leaves_the_finding():
    assert in_turbulence(QUIET, None, "") is QUIET


def test_no_clean_bill_beside_a_model_worse_than_trim():
    useless, good = (run_of(over("validate", [J])).fit for J in (1.5, 0.1))
    told = without_clean_bill(statement([QUIET], None, failing(useless)), useless)
    assert told.kind == "unknown"
    poor = "on the validate flights the model is worse than holding trim"
    assert told.sentence == f"No model could be identified from these flights: {poor}."
    assert without_clean_bill(statement([QUIET], None), good).kind == "nothing undeclared"


def test_a_load_that_sways_is_no_moving_air():
    """Of another simulator, in calm air: what a model without the load leaves is coloured as gusts colour it."""
    data = at_one_rate(load(shared("flightdata", "uh60-x1")))
    spec = propose(data, reconstruct(data), ())
    assert method_by_quiet_moments("auto", data, spec) == Choice("output-error", ALIKE)


def test_flights_without_quiet_moments():
    """Residuals' colour then is of the air or of the model: flights that no fit has seen decide."""
    data = flown(linear_vehicle(), {n: c[30:] for n, c in manoeuvres(8.0, 0.04).items()}, 0.04, noise=0.02, seed=2)
    spec = propose(data, reconstruct(data), ())
    assert method_by_quiet_moments("auto", data, spec) == Choice("auto", sure=False)
    assert method_by_quiet_moments("filter-error", data, spec) == Choice("filter-error")


def test_velocities_that_are_late_against_the_attitude_are_no_moving_air():
    """What a wrong clock leaves of the velocities is coloured as gusts colour it; with right clocks nothing decides."""
    for late, method in ((0.15, "output-error"), (-0.15, "output-error"), (0.0, "auto")):
        data = gliding(late)
        chosen = method_by_quiet_moments("auto", data, propose(data, reconstruct(data), ()))
        assert chosen.method == method
        assert ("late" in chosen.why, "early" in chosen.why) == (late > 0.0, late < 0.0)


def test_without_gusts_no_model_in_moving_air_is_made(caplog: pytest.LogCaptureFixture):
    """A model without velocities has nothing for gusts to act through."""
    model = rate_vehicle()
    data = flown(model, manoeuvres(3.0, 0.02), 0.02)
    assert judge(model, data).flights == judge(model, data, gusts={}).flights
    assert caplog.records == []
