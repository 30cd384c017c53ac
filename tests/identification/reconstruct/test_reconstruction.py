"""Step 1 against flights whose forces are known, against the rigid-body equations, and with channels taken away."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
import pytest
import torch
from torch import Tensor

from rotorid_torch.core import rigid
from rotorid_torch.core.integrate import simulate
from rotorid_torch.data import Dataset, load
from rotorid_torch.errors import InputError
from rotorid_torch.identification.reconstruct.motion import AXES, Motion
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction, reconstruct
from rotorid_torch.identification.reconstruct.sensor_biases import kinematic_biases
from tests.helpers import shared

MASS, INERTIA = 7000.0, [[7600.0, 0.0, -2200.0], [0.0, 54000.0, 0.0], [-2200.0, 0.0, 50000.0]]
GRAVITY, DT, IMU = 9.80665, 1.0 / 60.0, [1.5, -0.3, 0.4]
NOISE = dict.fromkeys("pqr", 0.002) | dict.fromkeys(("phi", "theta", "psi"), 0.002)
NOISE |= dict.fromkeys("uvw", 0.05) | dict.fromkeys(("ax", "ay", "az"), 0.05) | {"height": 0.2}


def truth(seed: int, samples: int) -> tuple[Tensor, Tensor]:
    """A moved control (T,) and what it does to X Y Z L M N per mass and inertia (T, 6): lagged steps about hover."""
    generator = np.random.default_rng(seed)
    time = np.arange(samples) * DT
    control = np.zeros(samples)
    for sign, begin, end in ((1.0, 1.0, 2.0), (-1.0, 2.0, 3.0)):
        control[(time >= begin) & (time < end)] = 0.03 * sign
    lagged, state = np.zeros((samples, 6)), np.zeros(6)
    lag = generator.uniform(0.1, 0.3, 6)
    for k in range(samples):
        state = state + DT / lag * (control[k] - state)
        lagged[k] = state
    forces = lagged * np.array([15.0, 10.0, 30.0, 8.0, 3.0, 5.0]) * generator.uniform(0.7, 1.3, 6)
    forces[:, 2] -= GRAVITY
    return torch.tensor(control), torch.tensor(forces)


def fly(seed: int, samples: int = 330) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Channels of one flight with sensor noise, and the true forces (T, 6) per mass and inertia."""
    control, forces = truth(seed, samples)
    inertia = torch.tensor(INERTIA, dtype=torch.float64)

    def rates(t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        velocity, omega, attitude = x[..., :3], x[..., 3:6], x[..., 6:9]
        return torch.cat(
            [
                rigid.velocity_rates(velocity, omega, attitude, u[..., :3], GRAVITY),
                u[..., 3:] + rigid.gyroscopic(omega, inertia),
                rigid.euler_rates(omega, attitude),
                rigid.position_rates(velocity, attitude)[..., 2:],
            ],
            dim=-1,
        )

    x = simulate(rates, torch.tensor([0.0] * 9 + [27.0], dtype=torch.float64), forces, DT)
    turn = forces[:, 3:] + rigid.gyroscopic(x[:, 3:6], inertia)
    at_imu = rigid.specific_force_at(torch.tensor(IMU, dtype=torch.float64), forces[:, :3], x[:, 3:6], turn)
    names = ("u", "v", "w", "p", "q", "r", "phi", "theta", "psi", "height", "ax", "ay", "az")
    columns = torch.cat([x, at_imu], dim=-1).numpy()
    rng = np.random.default_rng(seed + 1000)
    channels = {n: columns[:, i] + NOISE[n] * rng.standard_normal(samples) for i, n in enumerate(names)}
    channels |= {"time": np.arange(samples) * DT, "lon": control.numpy() + 0.0005 * rng.standard_normal(samples)}
    return channels, forces.numpy()


def dataset(flights: dict[str, dict[str, np.ndarray]], **vehicle: object) -> Dataset:
    declared = {"mass": MASS, "inertia": INERTIA, "imu": IMU} if not vehicle else vehicle
    present = {name for flight in flights.values() for name in flight}
    return Dataset.from_arrays(
        flights,
        identify=list(flights),
        vehicle={key: value for key, value in declared.items() if value is not None},
        controls={"lon": {"unit": "rad", "noise": 0.0005}},
        channels={name: {"noise": value} for name, value in NOISE.items() if name in present},
    )


def without(channels: dict[str, np.ndarray], names: Iterable[str]) -> dict[str, np.ndarray]:
    return {name: value for name, value in channels.items() if name not in names}


def errors(got: Reconstruction, name: str, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Error of the specific forces and moments over the spread of the true ones, and over their own deviation."""
    flight = got.flights[name]
    error = flight.specific.numpy() - true
    own = flight.specific_covariance.diagonal(dim1=-2, dim2=-1).sqrt().numpy()
    return np.sqrt((error**2).mean(axis=0)) / true.std(axis=0), np.abs(error) / own


def full_motion(**change: object) -> Motion:
    states = (*"uvwpqr", "phi", "theta", "psi", "north", "east", "height", *AXES, "p cos", "p sin")
    settings = {
        "states": states,
        "outputs": ("p", "height", "ax", "az", "qdot"),
        "tau": torch.tensor([1.0, 2.0, 3.0, 0.5, 0.6, 0.7], dtype=torch.float64),
        "trim": torch.randn(2, 1, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(1)),
        "dt": torch.tensor([0.01, 0.02], dtype=torch.float64)[:, None, None],
        "gravity": GRAVITY,
        "inertia": torch.tensor(INERTIA, dtype=torch.float64),
        "imu": torch.tensor(IMU, dtype=torch.float64),
        "lines": {"p": 12.0},
    }
    return Motion(**(settings | change))  # pyright: ignore[reportArgumentType]


def test_the_filters_equations_are_those_of_the_rigid_body() -> None:
    motion = full_motion()
    x = torch.randn(2, 5, 20, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    velocity, omega, attitude, forces, moments = x[..., :3], x[..., 3:6], x[..., 6:9], x[..., 12:15], x[..., 15:18]
    assert motion.inertia is not None
    assert motion.imu is not None
    turn = moments + rigid.gyroscopic(omega, motion.inertia)
    parts = [
        rigid.velocity_rates(velocity, omega, attitude, forces, GRAVITY),
        turn,
        rigid.euler_rates(omega, attitude),
        rigid.position_rates(velocity, attitude),
        (motion.trim - x[..., 12:18]) / motion.tau,
        torch.zeros(2, 5, 2, dtype=torch.float64),
    ]
    u = motion.inputs(torch.tensor([4, 3]))
    assert torch.allclose(motion.rates(x, u[:, :1]), torch.cat(parts, dim=-1) * motion.dt, atol=1e-13)
    assert motion.rates(x, u[:, 3:])[1].abs().max() == 0.0
    at_imu = rigid.specific_force_at(motion.imu, forces, omega, turn)
    line = x[..., 18] * u[:, 1:2, 0] + x[..., 19] * u[:, 1:2, 1]
    expected = torch.stack([omega[..., 0] + line, x[..., 11], at_imu[..., 0], at_imu[..., 2], turn[..., 1]], dim=-1)
    assert torch.allclose(motion.measure(x, u[:, 1:2]), expected, atol=1e-13)


def autocorrelation(values: np.ndarray, lags: int = 20) -> tuple[float, np.ndarray]:
    """Rms of a record with NaN, and its correlations with itself."""
    filled, count = np.nan_to_num(values), np.isfinite(values).sum()
    power = filled @ filled
    return (power / count) ** 0.5, np.array([filled[k:] @ filled[:-k] / power for k in range(1, lags + 1)])


def test_forces_and_moments_of_a_known_flight_lie_within_their_errors() -> None:
    flown = {f"f{seed}": fly(seed) for seed in range(3)}
    flown["f2"][0]["q"][100:130] = np.nan
    flown["f2"][0]["ax"][200:203] = np.nan
    got = reconstruct(dataset({name: channels for name, (channels, _) in flown.items()}))
    assert set(got.units.values()) == {"N", "N m"}
    for name, (_, true) in flown.items():
        share, own = errors(got, name, true)
        assert share.max() < 0.2
        assert (own < 3.0).mean() > 0.97
        assert 0.5 < (own < 1.0).mean() < 0.9
        for white in got.flights[name].innovations.values():
            size, correlations = autocorrelation(white.numpy())
            assert 0.7 < size < 1.2
            assert np.sqrt(np.mean(correlations**2)) < 0.15
    arrays = got.arrays("f0")
    assert {"time", "u", "height", "X", "N", "sd_X", "sd_u"} <= arrays.keys()
    assert np.allclose(arrays["X"], got.flights["f0"].specific[:, 0].numpy() * MASS)
    assert np.allclose(got.flights["f0"].moments.numpy(), got.flights["f0"].specific[:, 3:].numpy() @ np.array(INERTIA))


def test_flights_of_unequal_length_do_not_touch_each_other() -> None:
    (long, _), (short, true) = fly(0), fly(1, samples=260)
    got = reconstruct(dataset({"long": long, "short": short}))
    flight = got.flights["short"]
    assert flight.specific.shape == (260, 6)
    assert (errors(got, "short", true)[1] < 3.0).mean() > 0.97


def test_rates_and_accelerometers_alone_give_specific_force_and_angular_acceleration() -> None:
    channels, true = fly(3)
    alone = without(channels, ("u", "v", "w", "phi", "theta", "psi", "height", "ay"))
    got = reconstruct(dataset({"only": alone}, gravity=GRAVITY, imu=IMU))
    assert got.units == {**dict.fromkeys("XYZ", "m/s²"), **dict.fromkeys("LMN", "rad/s²")}
    assert "the channels do not tell u v w phi theta Y: left out of the reconstruction" in got.notes
    assert got.flights["only"].specific[:, 1].isnan().all()
    share, own = errors(got, "only", true)
    assert share[[0, 2, 3, 4, 5]].max() < 0.35
    assert (own[:, [0, 2]] < 3.0).mean() > 0.97


def test_velocity_and_attitude_alone_give_the_forces_too() -> None:
    channels, true = fly(4)
    got = reconstruct(dataset({"only": without(channels, ("ax", "ay", "az", "psi", "height"))}))
    share, own = errors(got, "only", true)
    assert share.max() < 0.6
    assert (own < 3.0).mean() > 0.95


def test_sensor_biases_that_kinematics_shows_are_taken_off_and_told() -> None:
    channels, true = fly(5)
    biased = channels | {"q": channels["q"] + 0.02, "ax": channels["ax"] + 0.5}
    got = reconstruct(dataset({"flight": biased}))
    found = got.flights["flight"].biases
    assert found == {"q": pytest.approx(0.02, abs=1e-3), "ax": pytest.approx(0.5, abs=0.05)}
    assert any("constant sensor errors" in note and "ax up to 0.5 m/s²" in note for note in got.notes)
    assert abs(float(got.flights["flight"].specific[:, 0].mean()) - true[:, 0].mean()) < 0.05


def test_a_gap_is_no_bias_of_the_sensors() -> None:
    """What turned and pushed the body while all sensors were silent is unknown, and no constant of gyros or forces."""
    channels, _ = fly(5)
    biased = channels | {"q": channels["q"] + 0.02, "ax": channels["ax"] + 0.5}
    silent = {name: values.copy() for name, values in biased.items()}
    for name in set(silent) - {"time", "lon"}:
        silent[name][130:180] = np.nan  # the body turns fastest then
    found = reconstruct(dataset({"flight": silent})).flights["flight"].biases
    assert found == {"q": pytest.approx(0.02, abs=1e-3), "ax": pytest.approx(0.5, abs=0.05)}


def test_sensors_that_never_record_together_have_no_biases() -> None:
    channels, _ = fly(5)
    apart = {name: values.copy() for name, values in channels.items()}
    for name in apart:
        if name in ("p", "q", "r"):
            apart[name][160:] = np.nan
        elif name not in ("time", "lon"):
            apart[name][:160] = np.nan
    data = dataset({"flight": apart})
    assert kinematic_biases(data, data.flights["flight"]) == {}


def test_a_vibration_line_gets_its_own_state_and_leaves_the_moments_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    channels, true = fly(6, samples=420)
    shaken = channels | {"p": channels["p"] + 0.05 * np.sin(2 * np.pi * 17.2 * channels["time"])}
    got = reconstruct(dataset({"flight": shaken}))
    monkeypatch.setattr("rotorid_torch.identification.reconstruct.sensor_biases.vibration_lines", lambda *_: {})
    raw = reconstruct(dataset({"flight": shaken}))
    assert got.lines == {"p": pytest.approx(17.2, abs=0.4)}
    assert not raw.lines
    quiet = slice(300, None)
    rest, widened = (
        float(np.std(each.flights["flight"].specific[quiet, 3].numpy() - true[quiet, 3])) for each in (got, raw)
    )
    assert rest < 0.3 * widened


def test_missing_rates_are_refused() -> None:
    channels, _ = fly(7)
    with pytest.raises(InputError, match="q"):
        reconstruct(dataset({"one": channels, "other": without(channels, "q")}))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["uh60-hover", "ah1-hover", "uh60b-hover"])
def test_true_forces_of_other_peoples_simulators_are_covered(name: str) -> None:
    data = load(shared("flightdata", name))
    some = [*data.identify[:4], *data.acid]
    data = dataclasses.replace(
        data, flights={n: data.flights[n] for n in some}, identify=tuple(some[:4]), validate=(), acid=data.acid
    )
    got = reconstruct(data)
    inside, close = [], []
    for flight in some:
        with np.load(shared("flightdata", name) / "truth" / f"{flight}.npz") as known:
            true = np.stack([known[axis].astype(float) for axis in AXES], axis=-1)
        size = np.abs(got.flights[flight].loads.numpy() - true) / got.flights[flight].loads_sd.numpy()
        inside.append((size < 3.0).mean(axis=0))
        close.append((size < 1.0).mean(axis=0))
    assert np.mean(inside, axis=0).min() > 0.96
    assert 0.55 < np.mean(close) < 0.85


def test_flights_that_go_through_the_filter_in_groups_come_out_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    data = dataset({f"f{seed}": fly(seed, 150)[0] for seed in range(2)})
    whole = reconstruct(data)
    monkeypatch.setattr("rotorid_torch.identification.reconstruct.reconstruction.TOGETHER", 150)
    monkeypatch.setattr("rotorid_torch.data.on_demand.BUDGET", 1)
    parts = reconstruct(data)
    assert parts.notes == whole.notes
    for name, flight in whole.flights.items():
        again = parts.flights[name]
        assert torch.allclose(again.specific, flight.specific, rtol=1e-9, atol=1e-9)
        assert torch.allclose(again.specific_covariance, flight.specific_covariance, rtol=1e-9, atol=1e-12)
        assert again.biases == flight.biases
        assert again.log_likelihood == pytest.approx(flight.log_likelihood, rel=1e-9)


def test_of_many_flights_some_tell_how_forces_change(monkeypatch: pytest.MonkeyPatch) -> None:
    data = dataset({f"f{seed}": fly(seed)[0] for seed in range(3)})
    monkeypatch.setattr("rotorid_torch.identification.reconstruct.reconstruction.SEARCHED", 2)
    monkeypatch.setattr("rotorid_torch.identification.reconstruct.force_noise.SEARCHED", 2)
    got = reconstruct(data)
    assert list(got.flights) == list(data.flights)
    assert any("2 of the 3 identify flights" in note for note in got.notes)
    share, own = errors(got, "f1", fly(1)[1])
    assert share.max() < 0.2
    assert (own < 3.0).mean() > 0.97
