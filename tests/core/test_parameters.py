"""Parameters: names, bounds that hold, free masks, and the table that prints."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from rotorid_torch.core.parameters import Parameter, ParameterSet, ParameterTable
from tests.mistakes import one_line


def a_set() -> ParameterSet:
    return ParameterSet((
        Parameter("L.p", -3.0, "1/s", (-50.0, 0.0), prior_sd=2.0),
        Parameter("delay", 0.0, "s", (0.0, 0.25), free=False),
        Parameter("X.u", unit="1/s"),
    ))  # fmt: skip


def test_columns_are_in_the_order_of_theta():
    parameters = a_set()
    assert parameters.names == ("L.p", "delay", "X.u")
    assert parameters.units == ("1/s", "s", "1/s")
    assert parameters.values.tolist() == [-3.0, 0.0, 0.0]
    assert parameters.lower.tolist() == [-50.0, 0.0, -math.inf]
    assert parameters.upper.tolist() == [0.0, 0.25, math.inf]
    assert parameters.prior_sd.tolist() == [2.0, math.inf, math.inf]
    assert parameters.values.dtype == torch.float64
    assert len(parameters) == 3
    assert [parameters.index(n) for n in parameters.names] == [0, 1, 2]


def test_values_outside_their_bounds_are_refused():
    for value in (0.5, math.nan, -51.0):
        with pytest.raises(ValueError, match=r"L\.p: .* outside its bounds"):
            Parameter("L.p", value, bounds=(-50.0, 0.0))
    with pytest.raises(ValueError, match=r"L\.p: typical 3\.0 lies outside its bounds"):
        Parameter("L.p", 0.0, bounds=(0.0, 1.0), typical=3.0)
    with pytest.raises(ValueError, match=r"L\.p: bounds 1\.0 to -1\.0 are reversed"):
        Parameter("L.p", 0.0, bounds=(1.0, -1.0))
    with pytest.raises(ValueError, match=r"L\.p: bounds 1\.0 to 1\.0 leave it no room; expected free=False"):
        Parameter("L.p", 1.0, bounds=(1.0, 1.0))


@pytest.mark.parametrize("bounds", [np.array([-1.0, 1.0]), torch.tensor([-1.0, 1.0]), [np.float32(-1), 1], (-1, 1)])
@pytest.mark.parametrize("value", [torch.tensor(0.5), np.array(0.5), np.float32(0.5)])
def test_numbers_of_any_kind_are_taken(value: Any, bounds: Any):
    declared = Parameter("drag", value, bounds=bounds, typical=value, met=[value], tried=np.array([0.25]))  # pyright: ignore
    assert declared == Parameter("drag", 0.5, bounds=(-1.0, 1.0), typical=0.5, met=(0.5,), tried=(0.25,))
    assert hash(declared) == hash(Parameter("drag", 0.5, bounds=(-1.0, 1.0), typical=0.5, met=(0.5,), tried=(0.25,)))


@pytest.mark.parametrize("bounds", ["01", ("0", "1"), 1.0, None, (0.0,), np.zeros(3), np.zeros((2, 2)), (0.0, 1j)])
def test_bounds_that_are_no_pair_of_numbers_are_refused(bounds: Any):
    one_line(lambda: Parameter("drag", bounds=bounds), "drag")


@pytest.mark.parametrize("value", ["0.5", None, torch.zeros(2), np.zeros(2), 1j])
def test_values_that_are_no_numbers_are_refused(value: Any):
    one_line(lambda: Parameter("drag", value, bounds=(0.0, 1.0)), "drag")


def test_a_name_declared_twice_is_told():
    with pytest.raises(ValueError, match=r"declared twice.*'b'") as refusal:
        ParameterSet((Parameter("a"), Parameter("b"), Parameter("b")))
    assert "'a'" not in str(refusal.value)


def test_unknown_names_are_told_with_those_that_exist():
    with pytest.raises(KeyError, match=r"no parameter 'L\.q'.*L\.p, delay, X\.u"):
        a_set().index("L.q")
    assert "L.q" not in a_set()
    assert "L.p" in a_set()


@given(st.lists(st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3), min_size=1, max_size=4))
def test_clamp_holds_the_bounds_and_nothing_else(rows: list[list[float]]):
    theta = torch.tensor(rows, dtype=torch.float64)
    parameters = a_set()
    held = parameters.clamp(theta)
    assert held.shape == theta.shape
    assert bool(((held >= parameters.lower) & (held <= parameters.upper)).all())
    inside = (theta >= parameters.lower) & (theta <= parameters.upper)
    assert torch.equal(held[inside], theta[inside])
    assert torch.equal(parameters.clamp(held), held)


@dataclass
class Estimated:
    """A parameter of a result."""

    name: str
    value: float | None
    se: float | None
    unit: str
    bounds: tuple[float, float]
    status: str
    at_bound: bool = False


class Estimates(ParameterTable):
    """A result of four parameters."""

    parameters = (
        Estimated("L.p", -3.1234567, 0.1, "1/s", (-50.0, 0.0), "free"),
        Estimated("delay", 0.02, None, "s", (0.0, 0.25), "frozen"),
        Estimated("X.u", 0.5, math.nan, "1/s", (-math.inf, math.inf), "not identifiable"),
        Estimated("Z.w", 0.0, math.nan, "1/s", (-9.0, 0.0), "free", at_bound=True),
    )


def test_table_prints_one_parameter_a_line():
    lines = Estimates().text().splitlines()
    assert lines[0].split() == ["name", "value", "se", "unit", "bounds", "status"]
    assert lines[1].split() == ["L.p", "-3.1235", "0.1", "1/s", "-50", "..", "0", "free"]
    assert lines[2].split() == ["delay", "0.02", "-", "s", "0", "..", "0.25", "frozen"]
    assert lines[3].split() == ["X.u", "0.5", "-", "1/s", "-inf", "..", "inf", "not", "identifiable"]
    assert lines[4].split() == ["Z.w", "0", "-", "1/s", "-9", "..", "0", "on", "a", "bound"]
    assert len(lines) == 5


def test_a_parameter_is_there_by_the_end_of_its_name():
    assert Estimates()["p"] is Estimates()["L.p"]
    with pytest.raises(KeyError, match=r"did you mean L\.p"):
        Estimates()["L.pp"]
