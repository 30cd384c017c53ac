"""Flights of two kinds of log in one set of a multirotor."""

import numpy as np
import pytest

from rotorid_torch.data import Dataset
from rotorid_torch.errors import InputError


def test_logs_of_another_kind_are_left_out_of_a_multirotors_set_and_told():
    time = 0.01 * np.arange(400)
    moving = {c: np.sin(time * k) for k, c in enumerate(("p", "q", "r", "az"), start=3)}
    motors = {f"motor{k}": 0.5 + 0.1 * np.sin(time * k) for k in range(1, 5)}
    whole = {"time": time, **moving, **motors}
    states = {"time": time, "u": moving["p"], "v": moving["q"], "w": moving["r"], **motors}
    blind = {"time": time, **moving}
    flights = {"a": whole, "b": states, "c": whole, "d": blind}
    data = Dataset.from_arrays(flights, identify=["a", "b"], validate=["c", "d"], kind="multirotor")
    assert (data.identify, data.validate, tuple(data.flights)) == (("a",), ("c",), ("a", "c"))
    assert any(w.startswith("b, d left out: logs of another kind") for w in data.warnings)
    with pytest.raises(InputError, match="p: is missing"):
        Dataset.from_arrays({"b": states}, identify=["b"], kind="multirotor").require_rates()
