"""Rotor speeds without commands: the speeds are the controls."""

import numpy as np
import pytest

from rotorid_torch.data import Dataset
from rotorid_torch.errors import InputError

TIME = 0.01 * np.arange(400)


def flight(seed: int, *names: str) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    rates = {name: 0.1 * rng.standard_normal(len(TIME)) for name in "pqr"}
    return {"time": TIME, **rates, **{name: 400.0 + 80.0 * rng.random(len(TIME)) for name in names}}


def test_speeds_are_the_controls_where_no_command_is_recorded():
    speeds = ("omega1", "omega2", "omega10")
    data = Dataset.from_arrays(
        {"a": flight(0, *speeds), "b": flight(1, *speeds)}, identify=["a", "b"], kind="multirotor"
    )
    assert data.controls == ("motor1", "motor2", "motor10")
    largest = max(float(f.channels[name].max()) for f in data.flights.values() for name in speeds)
    for f in data.flights.values():
        for name in speeds:
            np.testing.assert_allclose(f.channels[f"motor{name[5:]}"], f.channels[name] / largest, rtol=1e-12)
    assert sum("the rotor speeds are the controls" in sentence for sentence in data.warnings) == 1


@pytest.mark.parametrize("name", ["omega", "omegab", "omega0"])
def test_the_main_rotor_s_speed_is_no_control(name: str):
    with pytest.raises(InputError, match="there is no control"):
        Dataset.from_arrays({"a": flight(0, name)}, identify=["a"])


def test_commands_that_are_recorded_stay_what_they_are():
    given = flight(0, "omega1") | {"motor1": 0.5 + 0.1 * np.sin(TIME)}
    data = Dataset.from_arrays({"a": given}, identify=["a"], kind="multirotor")
    np.testing.assert_allclose(data.flights["a"].channels["motor1"], given["motor1"])
    assert not any("are the controls" in sentence for sentence in data.warnings)
