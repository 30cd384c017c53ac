"""States that the channels tell, by the rank of the stacked Jacobian; motion that no channel tells apart."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from rotorid_torch.core.names import ATTITUDES, FORCES, MOMENTS, POSITIONS, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.data import Dataset
from rotorid_torch.data.schema import Vehicle
from rotorid_torch.data.velocities.source import with_velocities
from rotorid_torch.identification.reconstruct.motion import GaussMarkovForces, Motion
from rotorid_torch.identification.reconstruct.observability import left_out, observable, visible_in
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct

TIME = 0.02 * np.arange(200)
EVERYTHING = (*VELOCITIES, *RATES, *ATTITUDES, *POSITIONS, *FORCES, *MOMENTS)


def data(*channels: str) -> Dataset:
    names = ("lat", *RATES, *channels)
    flight = {"time": TIME, **{c: 0.01 * np.sin(TIME * (k + 1)) for k, c in enumerate(names)}}
    return Dataset.from_arrays({"f": flight}, identify=["f"])


def motion(states: tuple[str, ...], outputs: tuple[str, ...]) -> Motion:
    one = torch.ones(1, 1, 1, dtype=torch.float64)
    forces = GaussMarkovForces(1e9 * torch.ones(6).double(), torch.zeros(1, 1, 6))
    return Motion.of(Vehicle(), states, outputs, forces, one)


@pytest.mark.parametrize(
    ("channels", "states", "untold"),
    [
        ((*VELOCITIES, *ATTITUDES, *POSITIONS), EVERYTHING, ()),
        ((*ATTITUDES, *POSITIONS), (*RATES, *ATTITUDES, *MOMENTS), (*VELOCITIES, *POSITIONS, *FORCES)),
        ((), (*RATES, *MOMENTS), (*VELOCITIES, "phi", "theta", *FORCES)),
        (("az",), (*RATES, "Z", *MOMENTS), (*VELOCITIES, "phi", "theta", "X", "Y")),
        ((*VELOCITIES,), (*RATES, *MOMENTS), (*VELOCITIES, "phi", "theta", *FORCES)),
        ((*POSITIONS, "phi", "theta"), (*RATES, "phi", "theta", *MOMENTS), (*VELOCITIES, *POSITIONS, *FORCES)),
        (("height", "phi", "theta", "ax"), (*RATES, "phi", "theta", "X", *MOMENTS), (*VELOCITIES, "height", "Y", "Z")),
    ],
)
def test_states_that_the_channels_tell_stay_and_the_others_are_named(
    channels: tuple[str, ...], states: tuple[str, ...], untold: tuple[str, ...]
):
    found, outputs = observable(data(*channels))
    assert set(found) == set(states)
    assert set(outputs) <= {*RATES, *channels}
    dataset = data(*channels)
    assert set(left_out(dataset, observable(dataset)[0])) == set(untold)


def test_what_the_rank_leaves_open_no_record_tells_apart():
    """Without attitude or accelerometers a tilt and a steady force are one: integrated by SciPy, the outputs agree."""
    model = motion(EVERYTHING, (*VELOCITIES, *RATES))
    told = visible_in(model, torch.zeros(len(EVERYTHING), dtype=torch.float64))
    assert {"theta", "X", "phi", "Y", "north"}.isdisjoint(told)
    assert {*VELOCITIES, *RATES, *MOMENTS, "Z"} <= told
    u = model.inputs(torch.ones(1).double())[0, 0]

    def outputs(**start: float) -> np.ndarray:
        x0 = np.array([start.get(name, 0.0) for name in EVERYTHING])
        solved = solve_ivp(lambda _, x: model.rates(torch.from_numpy(x), u).numpy(), (0.0, 2.0), x0, rtol=1e-10)
        return solved.y[: len(model.outputs), -1]

    tilted = outputs(theta=0.001, X=model.gravity * np.sin(0.001), Z=-model.gravity * np.cos(0.001))
    np.testing.assert_allclose(tilted, outputs(Z=-model.gravity), atol=1e-7)
    assert np.abs(outputs(theta=0.001, Z=-model.gravity) - outputs(Z=-model.gravity)).max() > 1e-3


def test_an_accelerometer_beside_velocities_tells_attitude():
    level = torch.zeros(len(EVERYTHING), dtype=torch.float64)
    told = visible_in(motion(EVERYTHING, (*VELOCITIES, *RATES, *SPECIFIC_FORCES)), level)
    assert told == {*VELOCITIES, *RATES, "phi", "theta", *FORCES, *MOMENTS}  # in hover nothing tells heading or place
    ahead = level.clone()
    ahead[0] = 30.0
    along = motion(EVERYTHING, (*VELOCITIES, *RATES, *SPECIFIC_FORCES, *POSITIONS))
    assert "psi" in visible_in(along, ahead)
    assert "psi" not in visible_in(along, level)


def test_position_and_attitude_tell_the_velocities_that_were_made_of_them():
    made = with_velocities(data(*ATTITUDES, *POSITIONS))
    states, outputs = observable(made)
    assert set(states) == set(EVERYTHING)
    assert set(outputs) == {*RATES, *ATTITUDES, *POSITIONS}


def test_positions_that_are_held_leave_the_filter_as_it_was_without_them():
    """A slow position within a fast record tells no velocity: it is left out, and the other channels fit."""
    rng = np.random.default_rng(1)
    names = ("lat", *RATES, "phi", "theta")
    true = {c: 0.05 * np.sin(TIME * (k + 1)) for k, c in enumerate(names)}
    flight = {c: v + (0.002 * rng.standard_normal(len(v)) if c != "lat" else 0.0) for c, v in true.items()}
    slow = {c: np.repeat(5.0 * TIME[::10], 10) for c in POSITIONS}
    given = {"f": {"time": TIME, **flight, "psi": 1e-9 * TIME, **slow}}
    records = with_velocities(Dataset.from_arrays(given, identify=["f"]))
    assert "held or missing" in records.warnings[-1]
    found = reconstruct(records)
    assert "the channels do not tell u v w north east height X Y Z: left out of the reconstruction" in found.notes
    assert {"u", "north"}.isdisjoint(found.flights["f"].channels)
    white = torch.stack(list(found.flights["f"].innovations.values()))
    assert float(white[~white.isnan()].std()) == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize("speed", [0.0, 30.0, 100.0, 250.0])
def test_what_has_a_channel_of_its_own_is_told_at_any_speed(speed: float):
    at = torch.zeros(len(EVERYTHING), dtype=torch.float64)
    at[0], at[7] = speed, 0.3
    direct = (*VELOCITIES, *RATES, *ATTITUDES, *POSITIONS)
    assert visible_in(motion(EVERYTHING, direct), at) == set(EVERYTHING)
    assert visible_in(motion(EVERYTHING, (*RATES, *ATTITUDES, *POSITIONS)), at) == set(EVERYTHING)
