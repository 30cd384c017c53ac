"""Free runs: the state of the first second, windows, models that diverge, and scores as the interface defines them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
import torch

from rotorid_torch.core.integrate import simulate
from rotorid_torch.data import Dataset
from rotorid_torch.effects.spec import FlappingKind
from rotorid_torch.model.model import Model
from rotorid_torch.model.training.equilibrium import equilibrium
from rotorid_torch.run.fit_record import judge
from rotorid_torch.validate.free_run import free_run, windows
from tests.known_models import BODY, STICKS, flown, helicopter, linear_vehicle, manoeuvres, points, with_values

DT = 0.02


@pytest.fixture(scope="module")
def model() -> Model:
    return linear_vehicle()


@pytest.fixture(scope="module")
def clean(model: Model) -> Dataset:
    return flown(model, manoeuvres(9.0, DT), DT)


@pytest.fixture(scope="module")
def noisy(model: Model) -> Dataset:
    return flown(model, manoeuvres(9.0, DT), DT, noise=0.02)


def without(data: Dataset, flight: str, *channels: str, samples: slice = slice(None)) -> Dataset:
    """The data set with some samples of a flight missing."""
    flights: dict[str, Mapping[str, np.ndarray]] = {}
    for name, f in data.flights.items():
        flights[name] = {c: v.numpy().copy() for c, v in f.channels.items()}
        for c in channels if name == flight else ():
            flights[name][c][samples] = math.nan
    return Dataset.from_arrays(
        flights,
        identify=data.identify,
        validate=data.validate,
        acid=data.acid,
        vehicle=data.vehicle,
        controls=dict(data.control_specs),
        channels=dict(data.channel_specs),
    )


def test_initial_state_is_recovered_from_the_first_second(model: Model, clean: Dataset):
    for start in (0, 100, 237):  # at rest, and in the middle of a manoeuvre
        states, outputs = free_run(model, windows(model, clean, [("f_lon", start), ("f_col", start)], 150))
        for k, name in enumerate(("f_lon", "f_col")):
            truth = clean.flights[name].stack(model.layout.names)[start : start + 150]
            torch.testing.assert_close(states[k], truth, atol=1e-6, rtol=0)
        torch.testing.assert_close(outputs[..., :8], states)


def test_initial_state_is_better_than_one_noisy_sample(model: Model, clean: Dataset, noisy: Dataset):
    places = [(f, k) for f in noisy.flights for k in range(0, 400, 40)]
    pieces = windows(model, noisy, places, 51)
    states, _ = free_run(model, pieces)
    truth = torch.stack([clean.flights[f].stack(BODY)[k] for f, k in places])
    error, sample = (e.square().mean(0).sqrt() for e in (states[:, 0] - truth, pieces.measured[:, 0, :8] - truth))
    assert bool((error < 0.6 * sample).all())


def test_the_first_second_alone_decides(model: Model, noisy: Dataset):
    changed = without(noisy, "f_lon", *BODY, samples=slice(51, None))
    both = [free_run(model, windows(model, data, [("f_lon", 0)], 400))[0] for data in (noisy, changed)]
    assert torch.equal(both[0], both[1])


def test_other_pieces_of_the_batch_change_nothing(model: Model, noisy: Dataset):
    alone, _ = free_run(model, windows(model, noisy, [("f_lon", 0)], 400))
    among, _ = free_run(model, windows(model, noisy, [("f_col", 150), ("f_lon", 0), ("f_lat", 90)], 400))
    torch.testing.assert_close(among[1], alone[0], rtol=1e-9, atol=1e-9)


def test_missing_samples_are_left_out(model: Model, clean: Dataset):
    gaps = without(clean, "f_lon", "u", "q", samples=slice(0, 30))
    states, _ = free_run(model, windows(model, gaps, [("f_lon", 0)], 150))
    torch.testing.assert_close(states[0], clean.flights["f_lon"].stack(BODY)[:150], atol=1e-6, rtol=0)


def test_a_state_that_nothing_shows_starts_at_the_reference():
    model = linear_vehicle(reference={**linear_vehicle().reference, "u": 30.0})
    free = with_values(model, {f"forces.{row}.u": 0.0 for row in "XYZLMN"})
    data = without(flown(free, manoeuvres(6.0, DT), DT), "f_lon", *BODY)
    states, _ = free_run(free, windows(free, data, [("f_lon", 0)], 60))
    assert states[0, 0].tolist() == [free.reference[n] for n in BODY]


def test_windows_are_nan_beyond_the_end_and_controls_are_held(model: Model, clean: Dataset):
    samples = clean.flights["f_lon"].samples
    pieces = windows(model, clean, [("f_lon", samples - 100)], 150)
    assert pieces.measured.shape == (1, 150, len(model.body.outputs))
    assert bool(pieces.measured[0, :100].isfinite().all())
    assert bool(pieces.measured[0, 100:].isnan().all())
    last = clean.flights["f_lon"].stack(STICKS)[-1]
    assert torch.equal(pieces.controls[0, 100:], last.expand(50, -1))
    _, outputs = free_run(model, pieces)
    assert bool(outputs.isfinite().all())


def test_pieces_can_be_picked(model: Model, clean: Dataset):
    pieces = windows(model, clean, [("f_lon", 0), ("f_lat", 10), ("f_col", 20)], 50)
    some = pieces.pick([2, 0])
    assert some.names == ("f_col", "f_lon")
    assert some.starts == (20, 0)
    assert torch.equal(some.controls, pieces.controls[[2, 0]])


def test_the_control_path_sees_the_whole_record():
    model = with_values(linear_vehicle(effects=("control.delay",)), {"control.delay.common": 0.1})
    data = flown(model, manoeuvres(6.0, DT), DT)
    pieces = windows(model, data, [("f_lon", 60)], 50)
    record = data.flights["f_lon"].stack(STICKS)
    torch.testing.assert_close(pieces.controls[0], record[55:105], atol=1e-12, rtol=0)


@pytest.mark.parametrize("kind", ["first order", "algebraic", "none"])
def test_rotor_states_in_equilibrium_rest(kind: FlappingKind):
    model = helicopter(kind)
    x, u = points(model, 6)
    n = len(BODY)
    whole = equilibrium(model, x[:, :n], u)
    assert torch.equal(whole[:, :n], x[:, :n])
    rates = model(torch.tensor(0.0), whole, u)[:, n:]
    torch.testing.assert_close(rates, torch.zeros_like(rates), atol=1e-7, rtol=0)
    batch = equilibrium(model, x[None, :, :n].repeat(3, 1, 1), u)
    torch.testing.assert_close(batch, whole.expand(3, -1, -1), atol=1e-9, rtol=0)


def test_a_free_run_with_a_rotor_starts_with_the_rotor_at_rest():
    model = helicopter()
    data = flown(model, manoeuvres(4.0, DT), DT)
    states, _ = free_run(model, windows(model, data, [("f_lon", 0)], 60))
    u = data.flights["f_lon"].stack(STICKS)[:1]
    torch.testing.assert_close(states[:, 0], equilibrium(model, states[:, 0, :8], u), atol=1e-7, rtol=0)


@pytest.mark.parametrize("growth", [30.0, 300.0, 1e6])
def test_a_diverging_model_is_scored_and_not_a_crash(growth: float, noisy: Dataset):
    model = with_values(linear_vehicle(), {"forces.M.u": growth, "forces.Z.w": growth, "forces.L.v": growth})
    judged = judge(model, noisy)
    for record in judged.flights.values():
        assert record.J is not None
        assert math.isfinite(record.J)
        assert record.J > 10.0
    assert judged.scores.identify is not None


def test_a_model_that_gives_nan_is_scored_too(noisy: Dataset):
    model = linear_vehicle()
    model.theta.data[model.parameter_set.index("forces.L.p")] = math.nan
    states, _ = free_run(model, windows(model, noisy, [("f_lon", 0)], 100))
    assert bool(states.isfinite().all())


def test_scores_are_those_of_the_interface(model: Model, noisy: Dataset):
    record = judge(model, noisy).flights["f_lat"]
    flight = noisy.flights["f_lat"]
    measured, samples = flight.stack(BODY)[:400], 400  # 8 s
    x0 = free_run(model, windows(model, noisy, [("f_lat", 0)], samples))[0][0, 0]
    run = simulate(lambda t, x, u: model(t, x, u), x0, flight.stack(STICKS)[:samples], DT).detach()
    scale = torch.tensor([noisy.scales()[c] for c in BODY], dtype=torch.float64)
    noise = torch.tensor([noisy.noise(c) for c in BODY], dtype=torch.float64)
    held = measured[:25].mean(0)
    rms = lambda e: float((e / scale).square().mean().sqrt())  # noqa: E731
    assert record.J == pytest.approx(rms(run - measured), rel=1e-6)
    assert record.J_trim == pytest.approx(rms(measured - held), rel=1e-9)
    assert record.J_noise == pytest.approx(rms(noise), rel=1e-9)
    assert set(record.channels) == set(model.body.outputs)
    spread = (measured[:, 3] - measured[:, 3].mean()).square().sum()
    error = (run - measured)[:, 3]
    assert record.channels["p"].r2 == pytest.approx(float(1 - error.square().sum() / spread), rel=1e-6)
    assert record.channels["p"].rmse == pytest.approx(float(error.square().mean().sqrt()), rel=1e-6)


def test_scale_is_the_rms_about_the_first_half_second(noisy: Dataset):
    squares = []
    for name in noisy.identify:
        p = noisy.flights[name].channels["p"]
        squares.append((p - p[:25].mean()).square())
    assert noisy.scales()["p"] == pytest.approx(float(torch.cat(squares).mean().sqrt()))


def test_flights_shorter_than_eight_seconds_are_judged(model: Model):
    moves = manoeuvres(9.0, DT) | {"short": manoeuvres(3.0, DT)["f_lat"]}
    data = flown(model, moves, DT, noise=0.01)
    judged = judge(model, data)
    assert judged.flights["short"].J is not None
    assert judged.flights["short"].J < 0.1
    overlay = next(o for o in judged.overlays if o.flight == "short")
    assert len(overlay.time) == 400
    assert judged.flights["f_lon"].windows.median is not None
