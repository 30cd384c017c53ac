"""Turbulence shows before the pilot acts, vibration at multiples of the rotor speed; calm air shows neither."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from rotorid_torch.data import Dataset
from rotorid_torch.effects.examples import HELICOPTER
from rotorid_torch.trace.stochastic import SLOW, quiet_moments, stochastic_findings
from rotorid_torch.trace.terms.finding import EffectFinding

DT, SECONDS, QUIET_S = 0.01, 8.0, 1.5
NOISE = {"p": 0.002, "q": 0.002, "r": 0.002, "ax": 0.05, "ay": 0.05, "az": 0.05}
SPEED = HELICOPTER.rotor.speed if HELICOPTER.rotor is not None else 27.0


def flights(
    gust: float = 0.0, line: float = 0.0, seed: int = 0, off_trim: float = 0.0, heave: float = 0.0, upset: float = 0.0
) -> Dataset:
    rng, time = np.random.default_rng(seed), DT * np.arange(round(SECONDS / DT))
    made = {}
    for k in range(8):
        stick = np.where(time > QUIET_S, 0.05 * np.sin(2.0 * (time - QUIET_S) * (1 + 0.2 * k)), 0.0)
        shake = lfilter([1.0], [1.0, -0.98], rng.standard_normal(len(time))) * 0.2
        phase = rng.uniform(0.0, 2.0 * np.pi)
        values = {"p": 8.0 * stick, "q": 3.0 * stick, "r": stick, "ax": 5.0 * stick, "ay": stick, "az": -9.8 + stick}
        values["p"] = values["p"] + gust * shake + off_trim * NOISE["p"] * (-1) ** k * np.exp(-time)
        values["ax"] = values["ax"] + upset * shake
        values["az"] = values["az"] + heave * shake + line * np.sin(4.0 * SPEED * time + phase)
        measured = {c: v + NOISE[c] * rng.standard_normal(len(time)) for c, v in values.items()}
        made[f"f{k}"] = {"time": time, "lat": stick + 1e-5 * rng.standard_normal(len(time)), **measured}
    names = list(made)
    channels = {c: {"noise": n} for c, n in NOISE.items()}
    lists = {"identify": names[:5], "validate": names[5:]}
    return Dataset.from_arrays(made, channels=channels, controls={"lat": {"unit": "rad", "noise": 1e-5}}, **lists)


def found(data: Dataset) -> dict[str, EffectFinding]:
    return {f.id: f for f in stochastic_findings(data, HELICOPTER, {"az": 0.5})}


@pytest.mark.parametrize("seed", range(5))
def test_calm_air_shows_neither(seed: int):
    told = found(flights(seed=seed))
    assert told["environment.turbulence"].verdict == "below floor"
    assert told["environment.vibration"].verdict == "below floor"


def test_turbulence_is_seen_before_the_pilot_acts():
    told = found(flights(gust=0.01))["environment.turbulence"]
    assert told.verdict == "accepted"
    assert " p " in told.reason


def test_gusts_are_as_large_as_the_accelerometer_that_shows_them_most_says():
    """A large response along an axis that gusts do not shake says nothing of their size."""
    told = {f.id: f for f in stochastic_findings(flights(heave=0.3), HELICOPTER, {"az": 0.5, "ax": 3.0})}
    assert told["environment.turbulence"].verdict == "accepted"
    assert 0.1 < told["environment.turbulence"].values["environment.turbulence.intensity"][0] < 0.6


def test_an_attitude_that_gusts_upset_says_nothing_of_their_size():
    """It shows most, along an axis on which gusts themselves hardly act."""
    data = flights(heave=0.3, upset=0.6)
    told = {f.id: f for f in stochastic_findings(data, HELICOPTER, {"az": 0.5, "ax": 0.004})}["environment.turbulence"]
    assert " ax " in told.reason
    assert 0.1 < told.values["environment.turbulence.intensity"][0] < 0.6


@pytest.mark.parametrize("line", [0.3, 0.85, 3.0])
def test_a_line_of_the_rotor_is_no_gust(line: float):
    told = found(flights(line=line))
    assert told["environment.turbulence"].verdict == "below floor"
    assert told["environment.vibration"].verdict == "accepted"
    assert found(flights(line=line, heave=0.3))["environment.turbulence"].verdict == "accepted"


def test_flights_that_begin_out_of_trim_are_in_calm_air():
    """What an aircraft does that was let go before it had settled is smooth; gusts are not."""
    assert found(flights(off_trim=8.0))["environment.turbulence"].verdict == "below floor"
    assert found(flights(off_trim=8.0, gust=0.01))["environment.turbulence"].verdict == "accepted"


def test_a_line_at_blade_passage_is_vibration():
    told = found(flights(line=0.4))["environment.vibration"]
    assert told.verdict == "accepted"
    assert told.values["environment.vibration.accelerations"][0] == pytest.approx(0.4 / np.sqrt(2.0), rel=0.15)


def test_flights_that_begin_apart_are_not_alike_and_show_no_turbulence():
    """A level or a slow drift of its own in each flight: slow gusts, or flights not quite in trim."""
    assert quiet_moments(flights(), HELICOPTER).alike
    apart = flights(off_trim=3.0)
    quiet = quiet_moments(apart, HELICOPTER)
    assert (quiet.alike, quiet.shaken) == (False, False)
    told = found(apart)["environment.turbulence"]
    assert (told.verdict, told.reason) == ("below floor", SLOW)
