"""States that the channels tell, by the rank of the stacked Jacobian; motion that no channel tells apart."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from rotorid_torch.core.names import ATTITUDES, FORCES, MOMENTS, POSITIONS, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.data import Dataset
from rotorid_torch.data.schema import Vehicle
from rotorid_torch.identification.motion import Motion
from rotorid_torch.identification.observability import left_out, observable, seen

TIME = 0.02 * np.arange(200)
EVERYTHING = (*VELOCITIES, *RATES, *ATTITUDES, *POSITIONS, *FORCES, *MOMENTS)


def data(*channels: str) -> Dataset:
    names = ("lat", *RATES, *channels)
    flight = {"time": TIME, **{c: 0.01 * np.sin(TIME * (k + 1)) for k, c in enumerate(names)}}
    return Dataset.from_arrays({"f": flight}, identify=["f"])


def motion(states: tuple[str, ...], outputs: tuple[str, ...]) -> Motion:
    one = torch.ones(1, 1, 1, dtype=torch.float64)
    return Motion.of(Vehicle(), states, outputs, tau=1e9 * torch.ones(6).double(), trim=torch.zeros(1, 1, 6), dt=one)


@pytest.mark.parametrize(
    ("channels", "states", "untold"),
    [
        ((*VELOCITIES, *ATTITUDES, *POSITIONS), EVERYTHING, ()),
        ((*ATTITUDES, *POSITIONS), EVERYTHING, ()),
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
    assert set(left_out(data(*channels))) == set(untold)


def test_what_the_rank_leaves_open_no_record_tells_apart():
    """Without attitude or accelerometers a tilt and a steady force are one: integrated by SciPy, the outputs agree."""
    model = motion(EVERYTHING, (*VELOCITIES, *RATES))
    told = seen(model, torch.zeros(len(EVERYTHING), dtype=torch.float64))
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
    told = seen(motion(EVERYTHING, (*VELOCITIES, *RATES, *SPECIFIC_FORCES)), level)
    assert told == {*VELOCITIES, *RATES, "phi", "theta", *FORCES, *MOMENTS}  # in hover nothing tells heading or place
    ahead = level.clone()
    ahead[0] = 30.0
    along = motion(EVERYTHING, (*VELOCITIES, *RATES, *SPECIFIC_FORCES, *POSITIONS))
    assert "psi" in seen(along, ahead)
    assert "psi" not in seen(along, level)
