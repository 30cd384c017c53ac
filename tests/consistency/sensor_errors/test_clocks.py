"""The clock of the controls beside those of the sensors: found, taken out, and put into what the model reads."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import rotorid_torch as rotorid
from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.consistency.pairs.velocity_clock import VelocityClock
from rotorid_torch.consistency.sensor_errors.clocks import sensor_findings
from rotorid_torch.data import Dataset, load
from rotorid_torch.effects.base import Values
from rotorid_torch.effects.families.sensors import SensorDelay
from tests.consistency.sensor_errors.kinematic_cases import data
from tests.helpers import shared
from tests.known_models import flown, manoeuvres, rate_vehicle

DT = 0.02


def aircraft(late: float) -> Dataset:
    """Rolls, pitches and turns of a known vehicle whose controls are recorded late."""
    moves = manoeuvres(8.0, DT)
    both = {**moves, **{f"{name}_again": -0.8 * move for name, move in moves.items()}}
    lists = {"identify": list(moves), "validate": [f"{name}_again" for name in moves]}
    straight = flown(rate_vehicle(), both, DT, noise=0.02, seed=3, lists=lists)
    return without_errors(straight, {"delay.controls": -late}) if late else straight


def test_controls_recorded_late_are_found_and_put_right() -> None:
    late = aircraft(0.1)
    found = sensor_findings(late)
    own = next(p for p in found["sensors.delay"].parameters if p.name == "sensors.delay.controls")
    assert found["sensors.delay"].verdict == "accepted"
    assert found.effects == ("sensors.delay",)
    assert abs(own.value - 0.1) < 3.0 * own.se
    assert own.se < 0.02
    again = found.corrected(late)
    assert sensor_findings(again).effects == ()
    for name, flight in aircraft(0.0).flights.items():
        for control in late.controls:
            exact, got = (f.channels[control].numpy()[10:-10] for f in (flight, again.flights[name]))
            assert np.abs(got - exact).max() <= 0.7 * np.abs(np.diff(exact)).max() + 1e-9


def test_nothing_is_found_where_the_controls_are_on_time() -> None:
    assert sensor_findings(aircraft(0.0)).effects == ()


def test_other_clocks_keep_their_verdict() -> None:
    found = sensor_findings(data({"delay.attitude": 0.06}, 1, flights=5))
    assert found.effects == ("sensors.delay",)
    assert set(found.values) == {"sensors.delay.attitude"}


def test_a_certain_clock_is_not_lost_in_the_group_of_an_uncertain_one(monkeypatch: pytest.MonkeyPatch) -> None:
    moved = VelocityClock(0.14, 0.01, (0.1, 0.1), (0.02, 0.02), (0.5, 0.6, 0.7, 0.8))
    monkeypatch.setattr("rotorid_torch.consistency.sensor_errors.clocks.velocity_clock", lambda dataset: moved)
    alone = sensor_findings(aircraft(0.0))["sensors.delay"]
    assert (alone.verdict, alone.group) == ("indistinguishable", ("forces.drag",))
    both = sensor_findings(aircraft(0.1))["sensors.delay"]
    assert (both.verdict, both.group) == ("accepted", ())
    assert "partly stand for each other" in both.reason
    beside = sensor_findings(data({"delay.attitude": 0.06}, 1, flights=5))["sensors.delay"]
    assert (beside.verdict, beside.group) == ("accepted", ())


def test_the_model_reads_the_late_record_ahead() -> None:
    effect = SensorDelay(("p", "q", "r"))
    time = DT * torch.arange(200, dtype=torch.float64)

    def wave(t: torch.Tensor) -> torch.Tensor:
        return torch.stack([torch.sin(3.0 * t), torch.cos(2.0 * t)], dim=-1)

    names = tuple(p.name for p in effect.declared)
    vector = torch.tensor([0.055 if n == "controls" else 0.0 for n in names], dtype=torch.float64)
    read = effect.read(wave(time - 0.055), ("lat", "voltage"), DT, Values(vector, names))
    torch.testing.assert_close(read[:-5, 0], wave(time)[:-5, 0], atol=2e-4, rtol=0)
    assert torch.equal(read[:, 1], wave(time - 0.055)[:, 1])


def test_velocities_without_accelerometers_are_told_in_a_group_with_drag() -> None:
    measured = load(shared("flightdata", "trex550-translation"))
    found = sensor_findings(measured)
    clocks = found["sensors.delay"]
    assert (clocks.verdict, clocks.group) == ("indistinguishable", ("forces.drag",))
    assert found.values == {"sensors.delay.velocities": pytest.approx(-0.142, abs=0.01)}
    assert len({p.name for p in clocks.parameters}) == len(clocks.parameters)
    assert sensor_findings(found.corrected(measured)).effects == ()


@pytest.mark.slow
def test_the_loop_names_it_and_predicts_the_record_as_it_is() -> None:
    late = aircraft(0.1)
    loop = rotorid.close_loop(late)
    assert loop.verdict is not None
    assert (loop.verdict.kind, loop.verdict.effects) == ("undeclared", ("sensors.delay",))
    before, after = (fit.scores.validate if fit else None for fit in (loop.before, loop.after))
    assert before is not None
    assert after is not None
    assert before > 2.0 * after
