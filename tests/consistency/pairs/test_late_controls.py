"""Controls recorded late: told by at least their time where a response comes first, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal
from scipy.ndimage import uniform_filter1d

from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.consistency.examination.kinematics import precedence
from rotorid_torch.consistency.pairs.late_controls import followed_sticks, late_controls
from rotorid_torch.consistency.pairs.precedence import responses
from rotorid_torch.data import Dataset, load
from tests.helpers import shared

DT, SAMPLES = 0.01, 1500
CLEAN = ("uh60-hover", "uh60-delay", "ah1-hover", "uh60b-hover", "uh60-60kt", "uh60-x1", "uh60-x2", "uh60-x3")
MULTIROTORS = ("nanodrone", "crazyflie-motors", "crazypad-normal", "crazypad-x1", "crazypad-x2")


def commanded(late: float, lag: float = 0.0, seed: int = 0, drift: float = 0.0) -> Dataset:
    """Rates that a stabilising unit makes of smooth sticks, behind a lag; sticks recorded late, drifting by flight."""
    rng, flights = np.random.default_rng(seed), {}
    time = DT * np.arange(SAMPLES)
    for k in range(4):
        hertz, phase = rng.uniform(0.2, 1.2, (2, 6)), rng.uniform(0, 2 * np.pi, (2, 6))

        def sticks(t, hertz=hertz, phase=phase):
            return 0.1 * np.sin(2 * np.pi * hertz[:, None] * t[:, None] + phase[:, None]).sum(-1)

        moved = sticks(time)
        p, q = moved[0], moved[1]
        if lag:
            kernel = np.exp(-time / lag)
            p, q = (np.convolve(x, kernel / kernel.sum())[:SAMPLES] for x in (p, q))
        shown = sticks(time - late - drift * k)
        noise = 0.02 * rng.standard_normal((3, SAMPLES))
        flights[f"f{k}"] = {
            "time": time,
            "lat": shown[0],
            "lon": shown[1],
            "p": 2.0 * p + noise[0],
            "q": 2.3 * q + noise[1],
            "r": noise[2],
        }
    return Dataset.from_arrays(flights, identify=list(flights), controls={c: {"unit": "norm"} for c in ("lat", "lon")})


@pytest.mark.parametrize("late", [0.03, 0.06, 0.15])
@pytest.mark.parametrize("seed", range(3))
def test_late_sticks_are_told_within_three_standard_errors(late: float, seed: int) -> None:
    found = late_controls(commanded(late, seed=seed))
    assert found is not None
    assert {a.pair.right_name for a in found.sticks} == {"lat", "lon"}
    assert abs(found.seconds - late) < 3.0 * found.se
    assert found.se < 0.2 * late


@pytest.mark.parametrize(("late", "lag"), [(0.0, 0.0), (0.0, 0.08), (0.01, 0.0), (0.06, 0.08)])
def test_a_response_that_does_not_clearly_precede_is_no_finding(late: float, lag: float) -> None:
    assert late_controls(commanded(late, lag)) is None


def test_clocks_that_drift_to_either_side_are_no_common_delay() -> None:
    assert late_controls(commanded(0.25, drift=-0.1)) is None


def test_exact_records_have_a_lag_and_an_error_too() -> None:
    time = DT * np.arange(SAMPLES)
    hertz, phase = np.random.default_rng(0).uniform((0.2, 0.0), (1.2, 6.0), (6, 2)).T

    def stick(t: np.ndarray) -> np.ndarray:
        return 0.1 * np.sin(2 * np.pi * hertz * t[:, None] + phase).sum(-1)

    flight = {"time": time, "lat": stick(time - 0.06), "p": 2.0 * stick(time)}
    found = late_controls(Dataset.from_arrays({"f": flight}, identify=["f"], controls={"lat": {"unit": "norm"}}))
    assert found is not None
    assert found.seconds == pytest.approx(0.06, abs=1e-5)
    assert 0.0 < found.se < 1e-3


def heaving(late: float, seed: int) -> Dataset:
    """Records without accelerometers: heave answers the collective at once, pitch the cyclic behind a rotor."""
    rng, flights = np.random.default_rng(seed), {}
    time = DT * np.arange(SAMPLES)

    def passed(numerator: list[float], denominator: list[float], values: np.ndarray) -> np.ndarray:
        return signal.lsim((numerator, denominator), values, time)[1]

    for k in range(4):
        hertz, phase = rng.uniform(0.2, 1.5, (2, 6)), rng.uniform(0.0, 2 * np.pi, (2, 6))

        def moved(t: np.ndarray, hertz: np.ndarray = hertz, phase: np.ndarray = phase) -> np.ndarray:
            return 0.02 * np.sin(2 * np.pi * hertz[:, None] * t[:, None] + phase[:, None]).sum(-1)

        lon, col = moved(time)
        q, w = passed([6.0], [0.12, 1.06, 0.5], lon), passed([-80.0], [1.0, 0.4], col)
        flight = {"time": time, "q": q, "w": w, "p": 0.0 * time, "u": 5.0 + 0.0 * time, "v": 0.0 * time}
        flight = {c: v + (0.002 * rng.standard_normal(SAMPLES) if c != "time" else 0.0) for c, v in flight.items()}
        shown = moved(time - late)
        flights[f"f{k}"] = flight | {"lon": shown[0], "col": shown[1]}
    return Dataset.from_arrays(flights, identify=list(flights))


@pytest.mark.parametrize("late", [0.05, 0.1, 0.2, 0.3])
@pytest.mark.parametrize("seed", range(2))
def test_without_accelerometers_the_rate_of_w_tells_late_controls(late: float, seed: int) -> None:
    found = late_controls(heaving(late, seed))
    assert found is not None
    assert found.clearest == "dw/dt"
    assert found.seconds == pytest.approx(late, abs=0.005)


@pytest.mark.parametrize("seed", range(3))
def test_without_accelerometers_controls_on_time_are_no_finding(seed: int) -> None:
    assert late_controls(heaving(0.0, seed)) is None


@pytest.mark.parametrize("band", [(0.2, 0.4), (0.3, 0.4)])
def test_a_stick_that_commands_an_attitude_is_not_late(band: tuple[float, float]) -> None:
    """The rate leads such a stick by up to a quarter of a period, and the vehicle answers in order all the same."""
    rng, flights = np.random.default_rng(0), {}
    time = DT * np.arange(SAMPLES)
    for k in range(4):
        hertz, phase = rng.uniform(*band, 6), rng.uniform(0.0, 2 * np.pi, 6)
        stick = 0.1 * np.sin(2 * np.pi * hertz * time[:, None] + phase).sum(-1)
        _, attitude, _ = signal.lsim(signal.lti([16.0], [1.0, 6.4, 16.0]), 5.0 * stick, time)
        p = np.gradient(attitude, DT) + 0.02 * rng.standard_normal(SAMPLES)
        flights[f"f{k}"] = {"time": time, "lat": stick, "phi": attitude, "p": p}
    dataset = Dataset.from_arrays(flights, identify=list(flights), controls={"lat": {"unit": "norm"}})
    (seen,) = followed_sticks(dataset)
    assert seen.lag_s < -0.1
    assert late_controls(dataset) is None


@pytest.mark.parametrize("gain", [0.1, 0.3])
def test_a_control_that_a_controller_moves_against_the_rate_is_not_late(gain: float) -> None:
    """As autopilots log it: gusts turn the vehicle, and what counts as its stick follows the rate."""
    rng, flights = np.random.default_rng(0), {}
    for k in range(4):
        gusts = np.convolve(rng.standard_normal(SAMPLES + 50), np.exp(-0.1 * np.arange(51)), "valid")
        p, phi, control = np.zeros(SAMPLES), 0.0, np.zeros(SAMPLES)
        for i in range(1, SAMPLES):
            control[i] = -gain * (p[max(0, i - 3)] + 0.5 * phi)
            p[i] = p[i - 1] + DT * (10.0 * control[i] - p[i - 1] + gusts[i])
            phi += DT * p[i]
        flights[f"f{k}"] = {"time": DT * np.arange(SAMPLES), "lat": control, "p": p}
    dataset = Dataset.from_arrays(flights, identify=list(flights), controls={"lat": {"unit": "norm"}})
    (seen,) = followed_sticks(dataset)
    assert seen.lag_s < -0.03
    assert late_controls(dataset) is None


def swinging(late: float) -> Dataset:
    """A roll that a controller stabilises while a load swings below; its control recorded late."""
    rng, flights = np.random.default_rng(0), {}
    time = DT * np.arange(SAMPLES)
    for k in range(4):
        begun, half = time > 1.0, 0.5 + 0.15 * k
        doublet = np.select([begun & (time < 1 + half), begun & (time < 1 + 2 * half)], [1.0, -1.0])
        p, phi, control, load, swing = np.zeros(SAMPLES), np.zeros(SAMPLES), 0.05 * (-1) ** k * doublet, 0.0, 0.0
        for i in range(1, SAMPLES):
            control[i] -= 0.3 * (p[i - 1] + 1.5 * phi[i - 1])
            p[i] = p[i - 1] + DT * (10.0 * control[i] - p[i - 1] - 0.3 * load)
            phi[i] = phi[i - 1] + DT * p[i]
            swing += DT * (9.8 * phi[i] - 2.56 * load - 0.05 * swing)
            load += DT * swing
        shown = np.interp(time - late, time, control) + 1e-4 * rng.standard_normal(SAMPLES)
        flights[f"f{k}"] = {"time": time, "lat": shown, "p": p + 0.002 * rng.standard_normal(SAMPLES)}
    return Dataset.from_arrays(flights, identify=list(flights), controls={"lat": {"unit": "rad"}})


def test_a_load_that_swings_is_no_late_record_of_the_controls_and_hides_none() -> None:
    """It turns the vehicle before the controller answers; without slow motion the control comes first."""
    (roll,) = responses(swinging(0.0))
    assert roll.lag_s < -0.03
    assert roll.r2 > 0.7
    assert late_controls(swinging(0.0)) is None
    assert not list(precedence(swinging(0.0)))  # nor do accelerations follow there
    late = late_controls(swinging(0.05))
    assert late is not None
    assert 0.04 < late.seconds < 0.06


@pytest.mark.parametrize("seed", range(4))
def test_late_at_least_is_not_more_than_late(seed: int) -> None:
    """Slow inputs in noise leave little without slow motion: its lag is uncertain, and not told for the other."""
    rng, flights, time = np.random.default_rng(seed), {}, DT * np.arange(SAMPLES)
    for k in range(4):
        half = 0.8 + 0.2 * k
        doublet = np.select([(time > 2) & (time < 2 + half), (time > 2) & (time < 2 + 2 * half)], [0.05, -0.05])
        control = (-1) ** k * uniform_filter1d(doublet, round(1.5 / DT))
        p = np.zeros(SAMPLES)
        for i in range(1, SAMPLES):
            p[i] = p[i - 1] + DT * (10.0 * control[i - 1] - 2.0 * p[i - 1])
        shown = np.interp(time - 0.06, time, control)
        flights[f"f{k}"] = {"time": time, "lat": shown, "p": p + 0.008 * rng.standard_normal(SAMPLES)}
    found = late_controls(Dataset.from_arrays(flights, identify=list(flights), controls={"lat": {"unit": "rad"}}))
    assert found is not None
    assert 0.05 < found.seconds < 0.07


@pytest.mark.parametrize("name", [*CLEAN, *MULTIROTORS, "trex550-translation"])
def test_nothing_is_told_where_streams_belong_together(name: str) -> None:
    dataset = load(shared("flightdata", name))
    assert late_controls(dataset) is None
    # margin: what precedes at all does so by less than a sample of these flights
    known = [r for r in responses(dataset) if r.r2 > 0.5 and r.gain > 0.1 and r.lag_se < 0.02]
    if name in CLEAN:
        assert known
        assert min(r.lag_s for r in known) > -0.006


@pytest.mark.parametrize("name", ["uh60-hover", "uh60b-hover"])
def test_blade_angles_recorded_late_are_told_by_what_responds_first(name: str) -> None:
    late = without_errors(load(shared("flightdata", name)), {"delay.controls": -0.1})
    found = late_controls(late)
    assert found is not None
    assert found.accelerations
    assert 0.07 < found.seconds < 0.1 + 0.005


def test_measured_sticks_that_are_late() -> None:
    found = late_controls(load(shared("flightdata", "trex550-rates")))
    assert found is not None
    assert found.seconds == pytest.approx(0.054, abs=0.003)
    assert found.clearest == "p"
