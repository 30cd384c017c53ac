"""What `check` says: silent on good data, plain words on each defect, and on the shared sets what is known of them."""

import re

import numpy as np
import pytest

from rotorid_torch.consistency.examination.check import check
from rotorid_torch.consistency.examination.surroundings import air, gravity, wind
from rotorid_torch.consistency.imu_place import place_of_imu, placed_pairs
from rotorid_torch.consistency.records.coherence import coherences
from rotorid_torch.consistency.records.vibration import lines, spectrum
from rotorid_torch.consistency.sensor_pairs import agreement, attitude_pairs
from rotorid_torch.data import Dataset, load
from rotorid_torch.importing.resample import on_grid
from tests.helpers import shared, shared_sets, small_flight

DT, SAMPLES = 0.01, 2000


def rolling(seed=0, late=0.0, scale=1.0, bias=0.0, arm=(0.0, 0.0, 0.0)):
    """A flight that turns by sines, with exact sensors but for the stated defects of p, attitude or the IMU's place."""
    time = DT * np.arange(SAMPLES)
    phases = np.random.default_rng(seed).uniform(0, 6, 3)

    def attitude(t):
        return [0.2 * np.sin(w * t + a) for w, a in zip((2.1, 1.7, 1.3), phases, strict=True)]

    def slope(t):
        return [0.2 * w * np.cos(w * t + a) for w, a in zip((2.1, 1.7, 1.3), phases, strict=True)]

    (phi, theta, _), (dphi, dtheta, dpsi) = attitude(time), slope(time)
    p = dphi - np.sin(theta) * dpsi
    q = np.cos(phi) * dtheta + np.sin(phi) * np.cos(theta) * dpsi
    r = -np.sin(phi) * dtheta + np.cos(phi) * np.cos(theta) * dpsi
    rates = np.stack([p, q, r], axis=1)
    speed = np.stack([3 * np.sin(0.9 * time), 2 * np.sin(1.1 * time), np.sin(0.7 * time)], axis=1)
    change = np.stack([2.7 * np.cos(0.9 * time), 2.2 * np.cos(1.1 * time), 0.7 * np.cos(0.7 * time)], axis=1)
    down = np.stack([-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta)], axis=1)
    turning = np.gradient(rates, DT, axis=0)
    arms = np.cross(turning, arm) + np.cross(rates, np.cross(rates, arm))
    felt = change + np.cross(rates, speed) - 9.80665 * down + arms
    told = attitude(time - late)
    rng = np.random.default_rng(seed + 100)
    channels = dict(zip(("u", "v", "w"), speed.T, strict=True)) | dict(zip(("ax", "ay", "az"), felt.T, strict=True))
    channels |= {"p": scale * p + bias, "q": q, "r": r, "phi": told[0], "theta": told[1], "psi": told[2]}
    channels |= {
        "lat": 0.05 * np.sign(np.sin(time)) * (time > 1),
        "lon": 0.05 * np.sign(np.sin(1.7 * time)) * (time > 1),
    }
    noisy = {name: values + 1e-3 * rng.standard_normal(SAMPLES) for name, values in channels.items()}
    return {"time": time, **noisy}


def dataset_of(vehicle=None, **defects):
    flights = {f"f{seed}": rolling(seed, **defects) for seed in range(3)}
    return Dataset.from_arrays(flights, identify=["f0", "f1"], validate=["f2"], vehicle=vehicle)


def sentences(dataset, *severities):
    return [f.sentence for f in check(dataset).findings if not severities or f.severity in severities]


def results(dataset, pairs):
    found = [agreement(pair, list(dataset.flights.values())) for pair in pairs]
    return [a for a in found if a is not None]


def test_consistent_sensors_agree():
    dataset = dataset_of()
    for a in results(dataset, (*attitude_pairs(), *placed_pairs(dataset))):
        assert a.r2 > 0.99
        assert abs(a.lag_s) < max(4 * a.lag_se, 1e-3)
        assert a.bounds == pytest.approx((1.0, 1.0), abs=0.01)
        assert a.scale == pytest.approx(1.0, abs=max(0.005, 4 * a.scale_se))
        assert abs(a.bias) < 0.01
    assert not [s for s in sentences(dataset, "warning", "error") if "against" in s]


@pytest.mark.parametrize("late", [0.05, -0.12])
def test_a_late_attitude_is_told_with_its_time(late):
    dataset = dataset_of(late=late)
    for a in results(dataset, attitude_pairs()):
        assert a.lag_s == pytest.approx(late, abs=0.004)
    word = "late" if late > 0 else "early"
    assert any(f"phi {abs(late):.3f} s {word}" in s for s in sentences(dataset, "warning"))


def test_scale_and_bias_of_a_gyro_are_told():
    assert any("scale factor" in s for s in sentences(dataset_of(scale=1.1), "warning"))
    assert any("wrong sign" in s for s in sentences(dataset_of(scale=-1.0), "error"))
    assert any(
        "reads 0.05 rad/s" in s and "too high by the kinematics of phi" in s
        for s in sentences(dataset_of(bias=0.05), "warning")
    )


def test_the_lever_arm_of_the_imu_is_taken_out():
    arm = (1.0, -0.5, 2.0)
    declarations = ({"imu": list(arm)}, None, {"imu": [0.0, 0.0, 0.0]})
    sets = [dataset_of(declared, arm=arm) for declared in declarations]
    for right, found, wrong in zip(*(results(d, placed_pairs(d)) for d in sets), strict=True):
        assert min(right.r2, found.r2) > 0.999
        assert 1 - wrong.r2 > 5 * (1 - right.r2)
    assert place_of_imu(sets[1]).point == pytest.approx(arm, abs=0.01)
    assert place_of_imu(dataset_of()).point == (0.0, 0.0, 0.0)


def doublets(arm, late=0.0, noise=0.02):
    """One flight of roll doublets in hover, its IMU away from the centre of gravity, its velocities late."""
    rng, time = np.random.default_rng(3), DT * np.arange(SAMPLES)
    p = 0.4 * sum(
        s * np.exp(-(((time - t) / 0.35) ** 2)) for t, s in ((4, 1), (5, -1), (9, -1), (10, 1), (14, 1), (15, -1))
    )
    turning = np.stack([np.gradient(p, DT), 0.05 * p, 0.1 * p], axis=1)
    rates = np.stack([p, 0.02 * np.sin(time), 0.03 * np.cos(0.8 * time)], axis=1)
    phi, theta = DT * np.cumsum(p), 0.01 * np.sin(0.5 * time)
    felt = np.stack([0.02 * np.sin(time), 0.1 * p, -9.8 + 0.05 * np.sin(1.3 * time)], axis=1)
    down = np.stack([-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta)], axis=1)
    speed = np.zeros((SAMPLES, 3))
    for k in range(SAMPLES - 1):
        speed[k + 1] = speed[k] + DT * (felt[k] + 9.80665 * down[k] - np.cross(rates[k], speed[k]))
    turning = np.gradient(rates, DT, axis=0)
    felt = felt + np.cross(turning, arm) + np.cross(rates, np.cross(rates, arm))
    told = np.stack([np.interp(time - late, time, column) for column in speed.T])
    rolled = np.gradient(phi, DT) - p  # of sums
    arrays = dict(zip("uvw", told, strict=True)) | dict(zip(("ax", "ay", "az"), felt.T, strict=True))
    arrays |= {"p": rates[:, 0] + rolled, "q": rates[:, 1], "r": rates[:, 2], "phi": phi, "theta": theta}
    sizes = dict.fromkeys("pqr", 0.002) | dict.fromkeys(("phi", "theta"), 0.001)
    arrays = {c: x + sizes.get(c, noise) * rng.standard_normal(SAMPLES) for c, x in arrays.items()}
    return Dataset.from_arrays({"f": {"time": time, "lat": 0.1 * p, **arrays}}, identify=["f"])


def test_an_undeclared_place_of_the_imu_is_no_lag_and_no_scale():
    arm = (-0.45, -0.48, 0.51)
    dataset = doublets(arm)
    assert place_of_imu(dataset).point[1:] == pytest.approx(arm[1:], abs=0.05)
    said = [f.sentence for f in check(dataset).findings if f.severity in ("warning", "error")]
    assert not any(word in sentence for sentence in said for word in (" late ", " early ", "scale factor"))


def test_an_undeclared_place_of_the_imu_is_no_gravity():
    measured = gravity(doublets((-0.45, -0.48, 0.51)))
    assert measured is not None
    assert abs(measured.values[0] - 9.80665) < 4.0 * measured.errors[0]


def test_late_velocities_are_told_beside_an_undeclared_place():
    (late,) = [
        f.sentence for f in check(doublets((-0.45, -0.48, 0.51), late=0.06)).findings if "s late (" in f.sentence
    ]
    told = re.search(r"v ([.0-9]+) s late", late)
    assert told
    assert float(told[1]) == pytest.approx(0.06, abs=0.01)


def test_noise_of_the_attitude_hides_gravity_where_nothing_tilts():
    rng, time = np.random.default_rng(5), DT * np.arange(SAMPLES)
    quiet = {c: 1e-3 * rng.standard_normal(SAMPLES) for c in ("p", "q", "r", "u", "v")}
    tilt = {
        c: 0.0005 * np.sin(w * time) + 0.003 * rng.standard_normal(SAMPLES) for c, w in (("phi", 0.6), ("theta", 0.7))
    }
    felt = {"ax": 9.80665 * 0.0005 * np.sin(0.7 * time), "ay": -9.80665 * 0.0005 * np.sin(0.6 * time)}
    climb = {"w": np.sin(time), "az": np.cos(time) - 9.80665, "col": 0.1 * np.sin(time)}
    flight = {"time": time, **quiet, **tilt, **{c: x + 1e-3 * rng.standard_normal(SAMPLES) for c, x in felt.items()}}
    dataset = Dataset.from_arrays({"f": flight | climb}, identify=["f"])
    measured = gravity(dataset)
    assert measured is not None
    assert abs(measured.values[0] - 9.80665) < 4.0 * measured.errors[0]
    assert not any("gravity" in s for s in sentences(dataset, "warning"))


def test_sticks_after_the_rate_are_told():
    flights = {}
    for seed in range(3):
        arrays = rolling(seed)
        arrays["p"] = np.roll(np.convolve(arrays["lat"], np.hanning(40) / 20, "same"), -15)
        flights[f"f{seed}"] = {name: arrays[name] for name in ("time", "lat", "p", "q", "r")}
    dataset = Dataset.from_arrays(flights, identify=["f0", "f1", "f2"], controls={"lat": {"unit": "norm"}})
    assert any("late against the rates (lat against p 0.145 s" in s for s in sentences(dataset, "warning"))


def test_gravity_axis_and_unit():
    flight = small_flight()
    for factor, word in ((-1.0, "Turn the axis"), (1 / 9.80665, "in g"), (1.1, "Calibrate")):
        dataset = Dataset.from_arrays({"f": flight | {"az": flight["az"] * factor}}, identify=["f"])
        assert any(word in s for s in sentences(dataset))
    for az, word in ((-flight["az"], "Turn the axis"), (flight["az"] + 9.80665, "without gravity")):
        assert any(
            word in s for s in sentences(Dataset.from_arrays({"f": flight | {"az": az}}, identify=["f"]), "error")
        )


@pytest.mark.parametrize(("factor", "word"), [(1 / 9.80665, "in g"), (-1.0, "Turn the axis"), (9.80665, "taken for g")])
def test_gravity_of_one_flight_in_another_unit(factor: float, word: str):
    plain = {f"f{k}": {c: v for c, v in rolling(k).items() if c not in "u v w phi theta psi".split()} for k in range(3)}
    other = plain | {"f1": plain["f1"] | {c: factor * plain["f1"][c] for c in ("ax", "ay", "az")}}
    for flights, spoilt in ((plain, []), (other, ["f1"])):
        told = check(Dataset.from_arrays(flights, identify=[*flights])).findings
        assert [
            f.flight for f in told if f.severity == "error" and "unlike in the other flights" in f.sentence
        ] == spoilt
        assert any(word in f.sentence for f in told) == bool(spoilt)


def test_still_saturated_and_missing_controls():
    flight = small_flight()
    flight["lat"] = np.clip(flight["lat"], -0.01, 0.01)
    flight["p"][100:140] = np.nan
    dataset = Dataset.from_arrays({"f": flight}, identify=["f"], controls={"lat": {"limits": [-0.01, 0.01]}})
    told = check(dataset).findings
    assert any(f.channel == "lon" and "hardly moves" in f.sentence for f in told)
    assert any(f.channel == "lat" and "on a limit" in f.sentence for f in told)
    assert any((f.channel, f.flight) == ("p", "f") and "10 % of the samples" in f.sentence for f in told)


def test_samples_that_are_missing_alike_are_one_finding():
    flights = {name: small_flight() for name in ("f", "g")}
    for channel in ("p", "q", "phi"):
        flights["f"][channel][100:108] = np.nan
    flights["g"]["q"][50:54] = np.nan
    flights["g"]["lat"][50:54] = np.nan
    told = check(Dataset.from_arrays(flights, identify=["f", "g"])).findings
    missing = [f for f in told if "missing" in f.sentence]
    assert [(f.channel, f.flight) for f in missing] == [("p phi q", ""), ("lat", "g")]
    assert "2 % of the samples are missing in 2 of 2 flights, most in f; they are skipped." in missing[0].sentence


def test_motor_commands_beyond_their_scale_are_not_fit():
    time = 0.01 * np.arange(400)
    motors = {f"motor{k}": 1.0 + 0.3 * np.sin(k * time) for k in (1, 2, 3, 4)}
    rates = dict.fromkeys(("p", "q", "r"), np.sin(time))
    dataset = Dataset.from_arrays({"f": {"time": time, **motors, **rates}}, identify=["f"], kind="multirotor")
    assert [f.channel for f in check(dataset).of("error")] == ["motor1", "motor2", "motor3", "motor4"]


def test_wrong_declared_noise_is_told():
    dataset = Dataset.from_arrays({"f": small_flight()}, identify=["f"], channels={"q": {"noise": 0.01}})
    assert any("declared noise is not the record's white floor (0.01, " in s for s in sentences(dataset, "warning"))


def test_a_control_that_follows_the_rates_has_no_share_of_its_own():
    arrays = rolling()
    rng = np.random.default_rng(9)
    arrays["lat"] = -0.5 * arrays["p"] - 0.2 * arrays["phi"] + 0.001 * rng.standard_normal(SAMPLES)
    dataset = Dataset.from_arrays({"f": arrays}, identify=["f"])
    assert any("feedback" in s and "lat" in s for s in sentences(dataset, "warning"))


def test_vibration_line_has_its_frequency_and_strength():
    rng = np.random.default_rng(2)
    time = DT * np.arange(6000)
    record = 0.1 * np.sin(2 * np.pi * 17.2 * time) + 0.01 * rng.standard_normal(6000)
    (line,) = lines(*spectrum([record], DT))
    assert line.hertz == pytest.approx(17.2, abs=0.4)
    assert line.rms == pytest.approx(0.1 / np.sqrt(2), rel=0.05)
    assert line.share > 0.95
    assert lines(*spectrum([rng.standard_normal(6000)], DT)) == []


def test_a_helicopter_without_rates_is_not_fit():
    arrays = {name: values for name, values in small_flight().items() if name not in ("p", "q", "r")}
    found = check(Dataset.from_arrays({"f": arrays}, identify=["f"]))
    assert not found.fit
    assert [f.channel for f in found.of("error")] == ["p", "q", "r"]
    assert "is missing; identify needs body rates" in found.of("error")[0].sentence


@pytest.mark.parametrize("name", shared_sets())
def test_shared_sets_are_fit(name):
    found = check(load(shared("flightdata", name)))
    assert found.fit
    assert found.dataset == name
    if name in ("uh60-hover", "uh60-60kt", "uh60-delay", "uh60b-hover"):
        assert {f.severity for f in found.findings} == {"good"}


def test_known_clocks_of_the_measured_sets():
    rates = sentences(load(shared("flightdata", "trex550-rates")), "warning")
    assert any("sticks are stamped 0.054 s (± 0.006) late against the rates (lat against p 0.053 s" in s for s in rates)
    moves = [f for f in check(load(shared("flightdata", "trex550-translation"))).of("warning")]
    assert any(f.channel == "u v w" and "0.152 s early" in f.sentence for f in moves)
    assert any(f.channel == "p" and "vibration at 34.7 Hz" in f.sentence for f in moves)
    assert any(f.channel == "az" and "sensor bias" in f.sentence for f in moves)


def test_a_wrong_time_base_is_told_with_the_right_interval():
    flights = {f"f{seed}": rolling(seed) for seed in range(3)}
    for arrays in flights.values():
        arrays["time"] = 1.25 * arrays["time"]
    (said,) = sentences(Dataset.from_arrays(flights, identify=["f0", "f1", "f2"]), "error")
    assert "times as fast as the body rates say, on all axes alike, and so velocities change" in said
    assert "are 0.01 s apart" in said


def test_rates_of_another_unit_are_no_wrong_time_base_where_velocities_are_recorded():
    flights = {f"f{seed}": rolling(seed) for seed in range(3)}
    for arrays in flights.values():
        arrays |= {rate: 1.5 * arrays[rate] for rate in "pqr"}
    (said,) = sentences(Dataset.from_arrays(flights, identify=["f0", "f1", "f2"]), "error")
    assert "the rates share a scale or unit error. Multiply them by 0.66" in said


def test_rates_that_all_go_the_wrong_way_are_no_wrong_time_base():
    flown = {f"f{seed}": rolling(seed) for seed in range(3)}
    turned = {n: {c: -v if c in ("p", "q", "r") else v for c, v in f.items()} for n, f in flown.items()}
    told = sentences(Dataset.from_arrays(turned, identify=list(turned)), "error")
    assert any("wrong sign" in s for s in told)


def test_one_gyro_off_scale_is_not_a_wrong_time_base():
    assert not any("time base" in s for s in sentences(dataset_of(scale=1.2)))


def test_frozen_held_cut_lone_and_repeated_samples_are_told():
    flights = {f"f{seed}": rolling(seed) for seed in range(2)}
    first = flights["f0"]
    first["q"][500:800] = first["q"][500]
    first["phi"] = np.clip(first["phi"], -0.15, 0.15)
    first["v"][1000] += 12.0
    first["theta"] = np.repeat(first["theta"][::10], 10)
    flights["f1"]["theta"] = np.repeat(flights["f1"]["theta"][::10], 10)
    by_channel = {}
    for f in check(Dataset.from_arrays(flights, identify=["f0", "f1"])).findings:
        by_channel[f.channel] = by_channel.get(f.channel, "") + f.sentence
    assert "frozen" in by_channel["q"]
    assert "cut off by its range" in by_channel["phi"]
    assert "1 samples stand alone" in by_channel["v"]
    assert "theta 9.95 Hz" in by_channel["theta"]
    held = {name: values.copy() for name, values in rolling(3).items()}
    for name in held:
        if name != "time":
            held[name][1::8] = held[name][::8]
    told = sentences(Dataset.from_arrays({"f": held}, identify=["f"]), "warning")
    assert any("rows repeat the one before in every channel (f 13% of them)" in s for s in told)


def closed_loop(test_input):
    """A multirotor that rolls under a controller fed by a noisy gyro sampled too slowly, with or without doublets."""
    rng = np.random.default_rng(5)
    command = 0.01 * rng.standard_normal(SAMPLES)
    time = DT * np.arange(SAMPLES)
    command += test_input * np.sign(np.sin(2 * np.pi * 0.7 * time)) * ((time > 2) & (time < 12))
    p = np.convolve(command, 20 * DT * np.exp(-3 * time))[:SAMPLES] + 1e-3 * rng.standard_normal(SAMPLES)
    thrust = 0.5 + 0.05 * np.sin(2.0 * time) + 1e-3 * rng.standard_normal(SAMPLES)
    place = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    motors = {f"motor{k}": thrust - 0.5 * y * command for k, (_, y) in enumerate(place, 1)}
    declared = [{"position": [0.1 * x, 0.1 * y, 0.0], "spin": "ccw" if x * y > 0 else "cw"} for x, y in place]
    flights = {"f": {"time": time, **motors, "p": p, "az": -20.0 * thrust}}
    return Dataset.from_arrays(flights, identify=["f"], kind="multirotor", vehicle={"motors": declared})


def test_folded_commands_without_a_test_input_are_told_and_real_ones_are_not():
    told = sentences(closed_loop(0.0), "warning")
    assert any(s.startswith("no test input on roll") and "cannot be told apart" in s for s in told)
    assert any("sampled without a filter (folded)" in s for s in told)
    assert not any("no test input" in s or "folded" in s for s in sentences(closed_loop(0.1)) if "roll" in s)


def test_commands_that_were_filtered_before_sampling_are_not_folded():
    whole, white = closed_loop(0.0), np.random.default_rng(1).standard_normal((4, 10 * SAMPLES))
    grid = DT * np.arange(SAMPLES)
    fine = np.linspace(0.0, grid[-1], 10 * SAMPLES)
    motors = {f"motor{k}": 0.5 + 0.05 * on_grid(fine, row, grid) for k, row in enumerate(white, 1)}
    flight = {c: v.numpy() for c, v in whole.flights["f"].channels.items()} | {"time": grid}
    filtered = Dataset.from_arrays({"f": flight | motors}, identify=["f"], kind="multirotor")
    picked = {name: 0.5 + 0.05 * row[::10] for name, row in zip(motors, white, strict=True)}
    sampled = Dataset.from_arrays({"f": flight | picked}, identify=["f"], kind="multirotor")
    assert any("folded" in s for s in sentences(sampled, "warning"))
    assert not any("folded" in s for s in sentences(filtered, "warning"))


def test_blade_angles_after_their_response_are_told():
    flights = {}
    for seed in range(4):
        rng, time = np.random.default_rng(seed), DT * np.arange(SAMPLES)
        stick = 0.05 * np.repeat(rng.choice([-1.0, 0.0, 1.0], SAMPLES // 50), 50)
        p = np.convolve(stick, 20 * DT * np.exp(-2 * time))[:SAMPLES] + 1e-3 * rng.standard_normal(SAMPLES)
        flights[f"f{seed}"] = {"time": time, "lat": np.roll(stick, 6), "p": p, "q": 0 * p, "r": 0 * p}
    # each sample's stick acts on the rate of that sample already: half an interval early
    controls = {"lat": {"unit": "rad"}}
    late = Dataset.from_arrays(flights, identify=list(flights), controls=controls)
    assert any("dp/dt 0.065 s" in s and "before the controls move" in s for s in sentences(late, "warning"))
    for arrays in flights.values():
        arrays["lat"] = np.roll(arrays["lat"], -12)
    early = Dataset.from_arrays(flights, identify=list(flights), controls=controls)
    assert any("dp/dt 0.055 s" in s and "follow the controls" in s for s in sentences(early, "good"))


def test_an_aircraft_that_answers_at_once_is_no_feedback():
    assert not any("feedback): only" in f.sentence for f in check(load(shared("flightdata", "ah1-hover"))).findings)


def test_gravity_and_wind_have_their_standard_errors():
    local = gravity(dataset_of())
    assert local is not None
    assert local.values[0] == pytest.approx(9.80665, abs=4 * local.errors[0])
    assert local.errors[0] < 0.05
    flights = {}
    for seed in range(4):
        rng, time = np.random.default_rng(seed), np.arange(0.0, 60.0, 0.1)
        heading, u = 0.1 * time + seed, 12.0 + np.sin(0.3 * time)
        north, east = u * np.cos(heading) - 3.0, u * np.sin(heading) + 4.0
        zero = 1e-9 * time
        airspeed = np.hypot(north, east) + 0.1 * rng.standard_normal(len(time))
        lat = np.sign(np.sin(time))
        flights[f"f{seed}"] = {"time": time, "lat": lat, "airspeed": airspeed, "u": u, "v": zero, "w": zero}
        flights[f"f{seed}"] |= {"phi": zero, "theta": zero, "psi": heading}
    by = wind(dataset_in_wind(flights))
    assert by is not None
    assert np.all(np.abs(by.values - [3.0, -4.0, 0.0]) < 4 * by.errors + 1e-3)
    assert np.all(by.errors < 0.05)
    assert not [one for one in air(dataset_in_wind(flights)) if one.severity == "error"]
    knots = {name: f | {"airspeed": f["airspeed"] * 3600.0 / 1852.0} for name, f in flights.items()}
    (unit,) = [one for one in air(dataset_in_wind(knots)) if one.severity == "error"]
    assert (unit.channel, "1.94" in unit.sentence, "knots?" in unit.sentence) == ("airspeed", True, True)


def dataset_in_wind(flights):
    return Dataset.from_arrays(flights, identify=list(flights), controls={"lat": {"unit": "norm"}})


@pytest.mark.parametrize("fault", ["", "sign", "unit", "late", "another"])
def test_angular_accelerations_are_the_rates_of_change_of_the_rates(fault):
    flights = {f"f{seed}": rolling(seed) for seed in range(3)}
    rng = np.random.default_rng(9)
    for flight in flights.values():
        exact = {f"{rate}dot": slow_slope(flight[rate]) for rate in ("p", "q", "r")}
        if fault == "late":
            exact = {name: np.roll(x, 10) for name, x in exact.items()}
        elif fault:
            exact["qdot"] = {"sign": -exact["qdot"], "unit": np.degrees(exact["qdot"]), "another": exact["pdot"]}[fault]
        flight |= {name: x + 0.01 * rng.standard_normal(SAMPLES) for name, x in exact.items()}
    said = [s for s in sentences(dataset_in_wind(flights), "warning", "error") if re.search("[pqr]dot|ar accel", s)]
    words = {"sign": "goes against", "unit": "times what qdot", "late": "0.100 s early", "another": "contradict each"}
    assert len(said) == bool(fault)
    assert all(words[fault] in sentence for sentence in said)


def slow_slope(x):
    """Rate of change (T,) of a noisy record whose noise is above its motion."""
    return np.gradient(np.convolve(np.pad(x, 10, "edge"), np.ones(21) / 21, "valid"), DT)


def test_coherence_ends_where_the_noise_begins():
    rng = np.random.default_rng(3)
    flights = {}
    for k in range(4):
        lat = rng.standard_normal(SAMPLES)
        p = np.convolve(lat, np.hanning(21) / 10, "same") + 0.3 * rng.standard_normal(SAMPLES)
        flights[f"f{k}"] = {"time": DT * np.arange(SAMPLES), "lat": lat, "p": p, "q": rng.standard_normal(SAMPLES)}
    dataset = Dataset.from_arrays(flights, identify=list(flights), controls={"lat": {"unit": "norm"}})
    p, q = coherences(dataset, ("p", "q"))
    assert p.band is not None
    assert p.band[0] < 0.2
    assert 4.0 < p.band[1] < 10.0
    assert q.band is None
    assert np.nanmax(q.values) < 0.4


def placed(seed=0, dt=DT):
    """A flight as `rolling` has it, with its position."""
    flight = rolling(seed)
    u, v, w, phi, theta, psi = (flight[c] for c in ("u", "v", "w", "phi", "theta", "psi"))
    level = u * np.cos(theta) + np.sin(theta) * (v * np.sin(phi) + w * np.cos(phi))
    side = v * np.cos(phi) - w * np.sin(phi)
    up = u * np.sin(theta) - np.cos(theta) * (v * np.sin(phi) + w * np.cos(phi))
    over = {"north": level * np.cos(psi) - side * np.sin(psi), "east": level * np.sin(psi) + side * np.cos(psi)}
    return flight | {name: dt * np.cumsum(rate) for name, rate in (over | {"height": up}).items()}


@pytest.mark.parametrize(("channel", "size"), [("psi", 0.4), ("u", -1.5), ("north", 4.0), ("theta", 0.08)])
def test_a_step_is_told_with_its_time_and_not_as_a_bias(channel, size):
    flights = {f"f{seed}": placed(seed) for seed in range(3)}
    flights["f1"][channel][1234:] += size
    found = check(Dataset.from_arrays(flights, identify=list(flights))).findings
    (step,) = [f for f in found if "which no motion makes" in f.sentence]
    assert (step.flight, step.channel) == ("f1", channel)
    told = re.search(rf"{channel} ([-+.0-9]+) \S+ at ([.0-9]+) s", step.sentence)
    assert told
    assert float(told[1]) == pytest.approx(size, rel=0.1)
    assert float(told[2]) == pytest.approx(12.34, abs=0.011)
    assert not any("bias" in f.sentence for f in found if f is not step and f.severity in ("warning", "error"))


def test_rows_that_are_missing_while_the_stamps_run_on_are_no_reset():
    flights = {f"f{seed}": placed(seed) for seed in range(3)}
    rows = {c: np.concatenate([x[:800], x[1130:]]) for c, x in flights["f1"].items()}
    flights["f1"] = rows | {"time": flights["f1"]["time"][:-330]}
    found = check(Dataset.from_arrays(flights, identify=list(flights))).findings
    (step,) = [f for f in found if "which no motion makes" in f.sentence]
    assert (step.flight, "a stretch is missing" in step.sentence) == ("f1", True)
    flights = {f"f{seed}": placed(seed) for seed in range(3)}
    flights["f1"]["theta"][1234:] += 0.1
    flights["f1"]["u"][1234:] += 2.0
    found = check(Dataset.from_arrays(flights, identify=list(flights))).findings
    assert any("an estimator was reset" in f.sentence for f in found)


def test_flips_spikes_and_turns_are_no_steps():
    flights = {f"f{seed}": placed(seed) for seed in range(2)}
    flights["f0"]["psi"] = (flights["f0"]["psi"] + 3.1 + np.pi) % (2 * np.pi) - np.pi
    flights["f1"]["u"][700:703] += 5.0
    found = check(Dataset.from_arrays(flights, identify=list(flights))).findings
    assert not any("no motion makes" in f.sentence for f in found)


def test_a_copy_in_another_list_is_an_error_and_a_stretch_is_named():
    flights = {f"f{seed}": rolling(seed) for seed in range(4)}
    flights["copy"] = {name: values.copy() for name, values in flights["f0"].items()}
    late = {name: values.copy() for name, values in flights["f3"].items()}
    for name, values in late.items():
        if name != "time":
            values[800:1600] = flights["f2"][name][300:1100]
    flights["f3"] = late
    data = Dataset.from_arrays(flights, identify=["f0", "f1", "f2", "f3"], acid=["copy"])
    found = [f for f in check(data).findings if "sample by sample" in f.sentence]
    assert {(f.severity, f.flight) for f in found} == {("error", "copy"), ("warning", "f3")}
    told = {f.flight: f.sentence for f in found}
    assert told["copy"].startswith("is a copy of f0")
    assert told["f3"].startswith("8.0 s from 8.0 s on repeat f2 from 3.0 s on")


@pytest.mark.parametrize("other", ["whole", "stretch"])
def test_a_copy_with_every_second_row_and_fewer_decimals_is_named(other):
    flights = {f"f{seed}": rolling(seed) for seed in range(3)}
    first = 300 if other == "stretch" else 0
    flights["copy"] = {n: np.round(v[first::2], 4) for n, v in flights["f0"].items()} | {
        "time": 2.0 * DT * np.arange((SAMPLES - first + 1) // 2)
    }
    data = Dataset.from_arrays(flights, identify=["f0", "f1", "f2"], acid=["copy"])
    (one,) = (f for f in check(data).findings if "sample by sample" in f.sentence or "copy" in f.sentence)
    assert (one.severity, one.flight) == ("error", "copy")
    assert "f0" in one.sentence


def test_a_reset_of_a_vector_is_no_contradiction_where_it_hardly_moves_one_channel():
    flights = {f"f{seed}": placed(seed) for seed in range(4)}
    for channel, size in (("u", 1.2), ("v", -0.9), ("w", 0.28)):
        flights["f1"][channel][1234:] += size
    found = check(Dataset.from_arrays(flights, identify=list(flights))).findings
    assert [f for f in found if "which no motion makes" in f.sentence]
    assert not [f for f in found if f.severity == "error"]


def test_flights_that_stand_still_before_they_begin_are_no_copies():
    flights = {f"f{seed}": rolling(seed) for seed in range(3)}
    for flight in flights.values():
        for name, values in flight.items():
            if name != "time":
                values[:400] = 0.25
    assert not any("sample by sample" in s for s in sentences(Dataset.from_arrays(flights, identify=list(flights))))


@pytest.mark.parametrize("step", [1e-3, 0.05])
def test_a_resolution_is_no_limit_of_range(step):
    flights = {f"f{seed}": placed(seed) for seed in range(2)}
    for flight in flights.values():
        slow = 0.3 * np.sin(0.9 * flight["time"] + 0.2)
        flight["height"] = 30.0 + step * np.round(slow / step)
    assert not any("cut off" in s for s in sentences(Dataset.from_arrays(flights, identify=list(flights))))


def turning(order=(0, 1, 2, 3), lag=0.06, unrelated=False):
    """A multirotor's flights with rotor speeds that follow the commands of motors in this order, a little late."""
    made = {}
    for seed in range(3):
        rng, time = np.random.default_rng(seed), DT * np.arange(SAMPLES)
        waves, phases = rng.uniform(0.3, 2.0, (4, 3)), rng.uniform(0.0, 6.0, (4, 3))

        def asked(t, waves=waves, phases=phases):
            apart = 0.05 * np.sin(2 * np.pi * waves[..., None] * t + phases[..., None]).sum(axis=1)
            return 0.5 + 0.1 * np.sin(t) + apart

        speeds = 600.0 * np.sqrt(asked(time - lag)[[*order]]) + 2.0 * rng.standard_normal((4, SAMPLES))
        if unrelated:
            speeds = speeds[:, ::-1]
        flight = {"time": time, **{f"motor{i + 1}": m for i, m in enumerate(asked(time))}}
        flight |= {f"omega{i + 1}": s for i, s in enumerate(speeds)}
        made[f"f{seed}"] = flight | {c: 0.1 * np.sin(2.0 * time + k) for k, c in enumerate("pqr")}
    return Dataset.from_arrays(made, identify=list(made), kind="multirotor")


@pytest.mark.parametrize("order", [(3, 1, 2, 0), (1, 2, 3, 0), (2, 3, 0, 1)])
def test_rotor_speeds_of_other_motors_are_told(order):
    (told,) = [f for f in check(turning(order)).findings if "paired with other motors" in f.sentence]
    assert told.severity == "error"
    assert f"omega1 follows motor{order[0] + 1}" in told.sentence


def test_rotor_speeds_follow_their_commands_or_contradict_them():
    found = check(turning(lag=0.1)).findings
    assert any(f.severity == "good" and "follows its command" in f.sentence for f in found)
    (told,) = [f for f in check(turning(unrelated=True)).findings if f.channel.startswith("omega1")]
    assert (told.severity, "contradict each other" in told.sentence) == ("error", True)


@pytest.mark.parametrize("difference", [0.0, 1e-3])
def test_motors_that_hardly_differ_tell_nothing_of_their_pairing(difference):
    made = {}
    for seed in range(2):
        rng, time = np.random.default_rng(seed), DT * np.arange(SAMPLES)
        together = 0.5 + 0.1 * np.sin(time)
        flight = {f"motor{i}": together + difference * rng.standard_normal(SAMPLES) for i in range(1, 5)}
        flight |= {f"omega{i}": 600.0 * np.sqrt(together) + 2.0 * rng.standard_normal(SAMPLES) for i in range(1, 5)}
        made[f"f{seed}"] = {"time": time, **flight} | {c: 0.1 * np.sin(2.0 * time + k) for k, c in enumerate("pqr")}
    found = check(Dataset.from_arrays(made, identify=list(made), kind="multirotor")).findings
    assert not [f for f in found if f.severity == "error"]


def test_velocities_that_nothing_tells_are_told_with_what_would():
    imu = ("ax", "ay", "az", "p", "q", "r", "phi", "theta")
    flights = {f"f{seed}": {c: v for c, v in rolling(seed).items() if c in ("time", "lat", *imu)} for seed in range(3)}
    missing = "u v w are not recorded"

    def advice(flights: dict, **declared) -> list[str]:
        found = check(Dataset.from_arrays(flights, identify=["f0", "f1"], **declared))
        return [one.sentence for one in found.of("note") if missing in one.sentence]

    without = {name: {c: v for c, v in f.items() if c not in imu[:3]} for name, f in flights.items()}
    assert "Record velocities" in advice(without)[0]
    assert 'reference = "hover"' in advice(flights)[0]
    assert not advice(flights, model={"reference": "hover"})
