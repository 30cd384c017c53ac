"""Predictions and responses of a quadrotor: exact for the model that flew, and for holding as the protocol says."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
import torch

from rotorid_torch.core.integrate import simulate
from rotorid_torch.core.names import ATTITUDES, POSITIONS
from rotorid_torch.data import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.effects.examples import BODY, MOTORS, MULTIROTOR
from rotorid_torch.effects.signal_operations import half_of
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.validate.predictions import predictions, unexplained_moments
from rotorid_torch.validate.responses import averaged, compared, least_motion, responses
from tests.known_models import with_values

DT, SAMPLES = 0.01, 300


def vehicle(**values: float) -> Model:
    spec = msgspec.structs.replace(MULTIROTOR, inputs=(), effects=("propulsion.rotor_inertia",))
    return with_values(build(spec), values)


def flown(model: Model, turn: float = 0.0) -> Flight:
    """A flight of a model from hover, turning, under slow commands on all axes."""
    time = DT * torch.arange(SAMPLES, dtype=torch.float64)
    waves = torch.stack([torch.sin((1.0 + 0.4 * k) * time) for k in range(4)], dim=-1)
    u = 0.6 + torch.tensor([0.003, 0.0003, 0.0003, 0.003]) * waves @ torch.tensor(
        [[1.0, 1, 1, 1], [-1, -1, 1, 1], [1, -1, -1, 1], [1, -1, 1, -1]], dtype=torch.float64
    )
    x0 = torch.zeros(len(model.layout), dtype=torch.float64)
    x0[model.layout.places(["r"])[0]] = turn
    with torch.no_grad():
        states = simulate(model, x0, u, DT)
        y = model.output(states, u)
    channels = dict(zip(model.body.outputs, y.unbind(-1), strict=True))
    arrays = {n: channels[n].numpy() for n in (*BODY, "ax", "ay", "az")} | {"psi": ((turn + 1e-12) * time).numpy()}
    arrays |= {n: (1e-12 * time).numpy() for n in POSITIONS} | dict(zip(MOTORS, u.numpy().T, strict=True))
    data = Dataset.from_arrays({"f": {"time": time.numpy(), **arrays}}, identify=["f"], kind="multirotor")
    return data.flights["f"]


def test_the_model_that_flew_predicts_its_rates_and_explains_everything():
    model = vehicle(**{"propulsion.rotor_inertia.N": 1.0})
    flight = flown(model)
    found = {(p.quantity, p.seconds): p for p in predictions(model, flight, starts=None)}
    assert set(found) == {(q, s) for q in ("rates", "attitude", "velocity", "position") for s in (0.1, 0.5, 1.0)}
    assert found["rates", 0.5].error < 1e-6 < 0.01 < found["rates", 0.5].held
    explained = responses(model, flight)
    assert min(explained[name].r2 for name in ("pdot", "qdot", "az")) > 0.999
    assert explained["rdot"].r2 > 0.99  # the commands are not straight lines between samples
    assert unexplained_moments(model, [flight]) == ()


def test_a_gap_is_no_start_of_a_prediction():
    """Half a second without sensors, and the model that flew still predicts all: what stands in the gap is no truth."""
    model = vehicle(**{"propulsion.rotor_inertia.N": 1.0})
    channels = {n: v.clone() for n, v in flown(model).channels.items()}
    for name in (*BODY, *ATTITUDES, *POSITIONS):
        channels[name][100:150] = torch.nan
    flight = Flight("gap", DT, channels)
    found = {(p.quantity, p.seconds): p for p in predictions(model, flight, starts=None)}
    assert all(found["rates", s].error < 1e-6 < 0.01 < found["rates", s].held for s in (0.1, 0.5, 1.0))
    assert unexplained_moments(model, [flight]) == ()


def test_rates_that_commands_predict_with_the_wrong_sign_are_not_explained():
    model, wrong = vehicle(), vehicle()
    flight = flown(model)
    with torch.no_grad():
        for row in "LM":
            wrong.theta[wrong.parameter_set.index(f"rotors.power.{row}")] *= -1.0
    assert unexplained_moments(wrong, [flight]) == ("L", "M", "N")  # where roll and pitch fail, so does yaw


def test_holding_is_what_the_protocol_says():
    model = vehicle()
    flight = flown(model, turn=0.8)
    found = {(p.quantity, p.seconds): p for p in predictions(model, flight, starts=None)}
    assert found["attitude", 0.5].held == pytest.approx(0.4, rel=0.06)  # angle of the rotation
    short = Flight("short", flight.dt, {n: v[:30] for n, v in flight.channels.items()})
    assert predictions(model, short) == ()
    blind = Flight("blind", flight.dt, {n: v for n, v in flight.channels.items() if n not in ATTITUDES})
    assert {p.quantity for p in predictions(model, blind)} == {"rates"}


def test_centred_mean_keeps_lines_and_takes_fewer_samples_at_the_ends():
    line = torch.arange(10, dtype=torch.float64)
    torch.testing.assert_close(averaged(line, 2)[2:-2], line[2:-2])
    assert averaged(line, 2)[0] == pytest.approx(1.0)
    wave = torch.sin(torch.arange(400, dtype=torch.float64) * 2 * math.pi / 5)
    assert float(averaged(wave, 2)[2:-2].abs().max()) < 1e-12


def test_a_flight_moves_a_response_that_stands_out_of_noise_and_of_what_is_usual():
    """Yaw is noise alone on the first flight; pitch moves a tenth of the usual on the second."""
    time = DT * torch.arange(1000, dtype=torch.float64)
    noise = torch.Generator().manual_seed(1)

    def rate(size: float) -> torch.Tensor:
        return size * torch.sin(6.0 * time) + 0.01 * torch.randn(len(time), generator=noise, dtype=torch.float64)

    def arrays(pitch: float, yaw: float) -> dict[str, torch.Tensor]:
        commands = {m: 0.6 + 0.1 * torch.sin(time + k) for k, m in enumerate(MOTORS)}
        return {"time": time, "p": rate(1.0), "q": rate(pitch), "r": rate(yaw), **commands}

    flights = {"first": arrays(1.0, 0.0), "second": arrays(0.1, 0.0)}
    numbers = {n: {c: v.numpy() for c, v in one.items()} for n, one in flights.items()}
    data = Dataset.from_arrays(numbers, identify=["first"], validate=["second"], kind="multirotor")
    least = least_motion(data)
    model = build(msgspec.structs.replace(MULTIROTOR, inputs=()))
    moved = {n: {c for c, r in responses(model, data.flights[n], least=least).items() if r.moved} for n in numbers}
    assert moved == {"first": {"pdot", "qdot"}, "second": {"pdot"}}


def test_a_gap_is_no_part_of_how_well_a_response_is_explained():
    """Half a second without gyros is missing; all around is as in the whole flight. Its seconds do not count."""
    time = DT * torch.arange(1000, dtype=torch.float64)
    commands = {m: 0.6 + 0.1 * torch.sin(time + k) for k, m in enumerate(MOTORS)}
    rates = {"p": torch.sin(6.0 * time), "q": torch.cos(5.0 * time), "r": 0.1 * torch.sin(time)}
    silent, pairs, seconds = slice(400, 400 + round(0.5 / DT)), [], []
    model = build(msgspec.structs.replace(MULTIROTOR, inputs=()))
    for gap in (False, True):
        numbers = {c: v.numpy().copy() for c, v in {"time": time, **rates, **commands}.items()}
        numbers["q"][silent] = np.nan if gap else numbers["q"][silent]
        flight = Dataset.from_arrays({"first": numbers}, identify=["first"], kind="multirotor").flights["first"]
        pairs.append(compared(model, flight)["qdot"][0])
        seconds.append(responses(model, flight)["qdot"].seconds)
    missing = pairs[1].isnan()
    torch.testing.assert_close(pairs[0][~missing], pairs[1][~missing], rtol=1e-9, atol=1e-9)
    assert 0.5 < float(missing.sum()) * DT < 0.58
    assert seconds[0] - seconds[1] == pytest.approx(float(missing.sum()) * DT)


def test_the_mean_that_responses_pass_does_not_hang_on_how_the_interval_is_rounded():
    assert {half_of(0.03, dt) for dt in (0.01, 0.00999992, 0.0100000001)} == {2}
    assert [half_of(0.03, dt) for dt in (0.02, 0.005, 0.002, 0.001)] == [1, 3, 8, 15]
