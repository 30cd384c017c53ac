"""Typical mistakes: each is answered in one line that names the argument and says what is expected of it."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

import rotorid_torch as rotorid
from rotorid_torch import arguments
from tests.mistakes import one_line

TIME = 0.02 * np.arange(60)
STEP = np.where(TIME > 0.2, 1.0, 0.0)
RESPONSE = np.where(TIME > 0.2, 1.5 * (1.0 - np.exp(-2.0 * (TIME - 0.2))), 0.0)
FLIGHT: dict[str, Any] = {
    "time": TIME,
    "controls": STEP[:, None],
    "outputs": RESPONSE[:, None] + 1e-3 * np.random.default_rng(0).standard_normal((60, 1)),
    "x0": np.zeros(1),
}


def scalar(value: float) -> nn.Parameter:
    return nn.Parameter(torch.tensor(value, dtype=torch.float64))


class Lag(nn.Module):
    """dx/dt = a x + b u, y = x."""

    def __init__(self) -> None:
        super().__init__()
        self.a, self.b = scalar(-1.0), scalar(1.0)

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return self.a * x + self.b * u

    def output(self, x: Tensor, u: Tensor) -> Any:
        return x


class Outputless(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.a = scalar(-1.0)

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        return self.a * x + u


class Timeless(Lag):
    def forward(self, x: Tensor, u: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        return self.a * x + self.b * u


class WithNumpy(Lag):
    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return self.a * np.sin(x) + self.b * u


class ToNumpy(Lag):
    def output(self, x: Tensor, u: Tensor) -> Any:
        return x.detach().numpy()


class Pair(Lag):
    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return self.a * x, self.b * u


class FirstEntry(Lag):
    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return (self.a * x[0] + self.b * u[0])[:, None]


class Broken(Lag):
    def output(self, x: Tensor, u: Tensor) -> Any:
        return self.gain * x  # pyright: ignore[reportOperatorIssue]


class TwoOutputs(Lag):
    def output(self, x: Tensor, u: Tensor) -> Any:
        return torch.cat([x, u], dim=-1)


class PlainNumber(Lag):
    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return self.a.item() * x + self.b * u


class Uncompiled(nn.Module):
    """dx/dt = a x + b u + use(k) I(x), y = x, in torch alone; k starts at 0."""

    def __init__(self, use: Callable[[Tensor], Tensor]) -> None:
        super().__init__()
        self.a, self.b, self.k, self.use = scalar(-1.0), scalar(1.0), scalar(0.0), use

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        return self.a * x + self.b * u + self.use(self.k) * torch.special.i0e(x)

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        return x


class ParameterToNumpy(Lag):
    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return torch.as_tensor(self.a.detach().numpy()) * x + self.b * u


class OfAllRows(Lag):
    """With the norm of a whole batch where that of each row is meant."""

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return self.a * x + self.b * u * (1.0 + x.norm())


class OfLargestRow(Lag):
    """A limit that all rows of a batch feel where one of them reaches it."""

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return self.a * x + self.b * u if x.max() < 2.0 else 0.0 * x


class OtherOrder(Lag):
    def forward(self, x: Tensor, u: Tensor, t: Tensor) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        return self.a * x + self.b * u


class InputsFirst(Lag):
    def output(self, u: Tensor, x: Tensor) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        return x


class Branched(Lag):
    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return self.a * x + self.b * u if x > 0.0 else self.a * x


class OfMath(Lag):
    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return self.a * math.sin(x) + self.b * u


class SinglePrecision(Lag):
    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return x @ torch.eye(1) * self.a + self.b * u


class OfTime(Lag):
    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return self.a * x * torch.sin(t) + self.b * u


class Bare(nn.Module):
    forward, output = Lag.forward, Lag.output


class InPlace(Lag):
    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return x.mul_(self.a) + self.b * u


class LogOfNegative(Lag):
    def output(self, x: Tensor, u: Tensor) -> Any:
        return torch.log(x - 1.0)


class WithoutColumns(Lag):
    def output(self, x: Tensor, u: Tensor) -> Any:
        return x[..., 0]


class Gusty(Lag):
    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return self.a * x + self.b * u + torch.randn_like(x)


class Layered(Lag):
    """With a layer between the state and its rate."""

    def __init__(self, layer: nn.Module) -> None:
        super().__init__()
        self.layer = layer.double()

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return self.a * self.layer(x) + self.b * u


class Turned(Lag):
    """With rates of another kind of numbers."""

    def __init__(self, turn: Callable[[Tensor], Tensor]) -> None:
        super().__init__()
        self.turn = turn

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return self.turn(self.a * x + self.b * u)


class Nothing(Lag):
    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> None:
        self.a * x + self.b * u


class Yielding(Lag):
    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        yield self.a * x + self.b * u


class Remembering(Lag):
    """With a tenth of the rate of the call before."""

    before: Any = 0.0

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        rate = self.a * x + self.b * u + (0.1 * self.before if getattr(self.before, "shape", None) == x.shape else 0.0)
        self.before = rate.detach()
        return rate


class Listed(Lag):
    """With a parameter that torch does not find."""

    def __init__(self) -> None:
        super().__init__()
        self.more = [scalar(0.5)]

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return self.a * x + self.b * u + self.more[0] * x**3


class Baseless(Lag):
    def __init__(self) -> None:
        pass


class OfMass(Lag):
    """With a mass that is no parameter."""

    def __init__(self) -> None:
        super().__init__()
        self.mass = 2.0


def starting_at(value: float) -> Lag:
    model = Lag()
    model.a = scalar(value)
    return model


class Complex(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.a = nn.Parameter(torch.tensor(-1.0 + 1.0j))

    forward, output = Lag.forward, Lag.output


class Locked(Lag):
    """With what cannot be copied."""

    def __init__(self) -> None:
        super().__init__()
        self.lock = threading.Lock()


class Clamped(Lag):
    """Whose parameter is another after the first call, and the same at all others."""

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        self.a.data.clamp_(max=-1.5)
        return self.a * x + self.b * u


class TransposedProduct(Lag):
    def __init__(self) -> None:
        super().__init__()
        self.A = nn.Parameter(torch.eye(1, dtype=torch.float64))

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return self.A @ x + self.b * u


class Plain(Lag):
    """With states, controls or outputs out of which numbers are taken."""

    def __init__(self, states: bool = False, outputs: bool = False) -> None:
        super().__init__()
        self.plain_states, self.plain_outputs = states, outputs

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Any:
        return self.a * (x.detach() if self.plain_states else x) + self.b * u

    def output(self, x: Tensor, u: Tensor) -> Any:
        return x.detach() if self.plain_outputs else x


class Two(nn.Module):
    """dx/dt = A x + B u, y = x, written for rows t [n], x [n, 2], u [n, 1]."""

    def __init__(self, write: str) -> None:
        super().__init__()
        self.A = nn.Parameter(torch.tensor([[-1.0, 0.1], [0.5, -2.0]]))
        self.B = nn.Parameter(torch.ones(2, 1))
        self.write = write

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        if self.write == "any":
            return x @ self.A.mT + u @ self.B.mT
        if self.write == "product":
            return (self.A @ x.mT + self.B @ u.mT).mT
        A, B = self.A, self.B
        return torch.stack([A[k, 0] * x[:, 0] + A[k, 1] * x[:, 1] + B[k, 0] * u[:, 0] for k in range(2)], 1)

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        return x if self.write == "any" else torch.stack([x[:, 0], x[:, 1]], 1)


def read_only(array: np.ndarray) -> np.ndarray:
    array = array.copy()
    array.setflags(write=False)
    return array


ACCEPTED: list[tuple[str, dict[str, Any]]] = [
    ("lists", {key: value.tolist() for key, value in FLIGHT.items()}),
    ("tuples", {key: tuple(map(tuple, value)) if value.ndim == 2 else tuple(value) for key, value in FLIGHT.items()}),
    ("tensors", {key: torch.as_tensor(value) for key, value in FLIGHT.items()}),
    ("float32", {key: value.astype(np.float32) for key, value in FLIGHT.items()}),
    ("views that run back", {key: value[::-1].copy()[::-1] for key, value in FLIGHT.items()}),
    ("arrays that are read only", {key: read_only(value) for key, value in FLIGHT.items()}),
    ("big endian", {key: value.astype(">f8") for key, value in FLIGHT.items()}),
    ("a masked array", FLIGHT | {"outputs": np.ma.masked_greater(FLIGHT["outputs"], 1e9)}),
    ("integers", FLIGHT | {"controls": STEP[:, None].astype(int), "x0": [0]}),
    ("objects", FLIGHT | {"outputs": FLIGHT["outputs"].astype(object)}),
    ("a tensor that asks for gradients", FLIGHT | {"outputs": torch.as_tensor(FLIGHT["outputs"]).requires_grad_()}),
    ("a list of tensors", FLIGHT | {"controls": [torch.tensor([value]) for value in STEP.tolist()]}),
]


@pytest.mark.parametrize("row", ACCEPTED, ids=[row[0] for row in ACCEPTED])
def test_arrays_of_any_kind_are_taken(row: tuple[str, dict[str, Any]]) -> None:
    first = rotorid.output_error(Lag(), [FLIGHT], x0="fixed")
    found = rotorid.output_error(Lag(), [row[1]], x0="fixed")
    for p, q in zip(first.parameters, found.parameters, strict=True):
        assert abs(p.value - q.value) < 1e-3 * p.se


@pytest.mark.parametrize("use", [torch.abs, torch.square, torch.relu])
@pytest.mark.parametrize("estimate", [rotorid.output_error, rotorid.filter_error])
def test_a_derivative_that_is_zero_at_the_start_is_a_derivative(
    estimate: Callable[..., Any], use: Callable[[Tensor], Tensor]
) -> None:
    short = {key: value[:25] for key, value in FLIGHT.items()}
    found = estimate(Uncompiled(use), [short], x0="fixed", max_iterations=1)
    assert [p.name for p in found.parameters][:3] == ["a", "b", "k"]


@pytest.mark.parametrize("use", [lambda k: abs(k.item()), lambda k: k.detach() ** 2], ids=["item", "detach"])
def test_a_plain_number_that_starts_at_zero_is_refused(use: Callable[[Tensor], Tensor]) -> None:
    one_line(lambda: rotorid.output_error(Uncompiled(use), [FLIGHT], x0="fixed"), "forward")


@pytest.mark.parametrize("write", ["product", "columns"])
@pytest.mark.parametrize(
    "estimate", [rotorid.output_error, partial(rotorid.output_error, solver="heun3"), rotorid.filter_error]
)
def test_models_may_be_written_for_rows(estimate: Callable[..., Any], write: str) -> None:
    flight = {"time": TIME, "controls": STEP[:, None], "outputs": FLIGHT["outputs"] * [1.0, 0.5], "x0": np.zeros(2)}
    flights = [{key: value[:30] if key != "x0" else value for key, value in flight.items()}, flight]
    first, found = (estimate(Two(form), flights, max_iterations=1) for form in ("any", write))
    for p, q in zip(first.parameters, found.parameters, strict=True):
        assert q.value == pytest.approx(p.value, rel=1e-6, abs=1e-6)


def test_a_look_up_by_a_state_needs_no_derivative() -> None:
    """A gain by the sign of the control and by the second of the flight."""

    class Scheduled(Lag):
        def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
            gains = x.new_tensor([1.0, 1.0])[t.long().clamp(0, 1)].unsqueeze(-1)
            return self.a * x + self.b * gains * (u > 0.0).to(x)

    assert rotorid.output_error(Scheduled(), [FLIGHT], x0="fixed", max_iterations=1).parameters[0].value < -1.0


def test_names_of_states_in_any_iterable() -> None:
    listed = rotorid.filter_error(Lag(), [FLIGHT], process_noise=["x[0]"], max_iterations=1)
    for names in ({"x[0]"}, (name for name in ["x[0]"])):
        found = rotorid.filter_error(Lag(), [FLIGHT], process_noise=names, max_iterations=1)  # pyright: ignore[reportArgumentType]
        assert found["a"].value == listed["a"].value


def test_a_model_of_torch_compile_is_taken_for_what_it_is() -> None:
    plain, compiled = (rotorid.output_error(model, [FLIGHT], x0="fixed") for model in (Lag(), torch.compile(Lag())))  # pyright: ignore[reportArgumentType]
    assert [(p.name, p.value) for p in compiled.parameters] == [(p.name, p.value) for p in plain.parameters]


def test_a_model_made_without_gradients_is_taken() -> None:
    with torch.inference_mode():
        model = Lag()
    assert rotorid.output_error(model, [FLIGHT], x0="fixed").converged


def test_places_are_whole_numbers_of_any_kind() -> None:
    for zero in (np.int64(0), torch.tensor(0)):
        found = rotorid.output_error(Lag(), [FLIGHT], x0={zero: "fixed"}, delays={zero: 0.02}, angles=[zero])
        assert found.initial_states.abs().max() < 1e-15
        assert found["delay[0]"].unit == "s"


def swept() -> dict[str, Any]:
    """8 s of dx/dt = -2 x + 3 u, in steps of a 50th of a second by the exact answer to ramps."""
    time, noise = 0.02 * np.arange(400), 0.01 * np.random.default_rng(0).standard_normal((400, 1))
    u, x, decay = np.sin(0.4 * time**2), np.zeros(400), math.exp(-0.04)
    for k in range(399):
        ramp = (u[k + 1] - u[k]) / 0.02
        x[k + 1] = decay * x[k] + 1.5 * ((1.0 - decay) * u[k] + ramp * (0.02 - (1.0 - decay) / 2.0))
    return {"time": time, "controls": u[:, None], "outputs": x[:, None] + noise, "x0": [0.0]}


def test_a_start_whose_derivatives_fly_away_is_no_error_of_python() -> None:
    assert not rotorid.output_error(starting_at(50.0), [swept()], max_iterations=8).converged


@pytest.mark.parametrize("unit", [0.001, 100.0, 1000.0])
def test_the_unit_of_time_does_not_matter(unit: float) -> None:
    """From segments of seconds that hold no sample, to records shorter than any pilot's motion."""
    slow, first = starting_at(-1.0 / unit), rotorid.output_error(Lag(), [swept()])
    with torch.no_grad():
        slow.b /= unit
    found = rotorid.output_error(slow, [swept() | {"time": unit * swept()["time"]}])
    assert found.converged
    for p, q in zip(first.parameters, found.parameters, strict=True):
        assert abs(p.value - unit * q.value) < 0.05 * p.se
        assert unit * q.se == pytest.approx(p.se, rel=0.1)


def test_a_noise_that_is_not_there_has_no_standard_error() -> None:
    """Two seconds of a random walk that is measured exactly."""
    walk = np.cumsum(np.random.default_rng(0).standard_normal((100, 1)), axis=0)
    flight = {"time": 0.02 * np.arange(100), "controls": np.zeros((100, 0)), "outputs": walk, "x0": walk[0]}

    class Walk(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.a = scalar(-1.0)

        def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
            return self.a * x

        def output(self, x: Tensor, u: Tensor) -> Tensor:
            return x

    found = rotorid.filter_error(Walk(), [flight])
    assert found.process_noise[0].value == pytest.approx(50.0**0.5, rel=0.3)
    assert found.process_noise[0].se > 0.0
    assert found.measurement_noise[0].at_bound
    assert math.isnan(found.measurement_noise[0].se)


def with_flight(**change: Any) -> dict[str, Any]:
    return {"flights": [FLIGHT | change]}


def without(key: str) -> dict[str, Any]:
    return {"flights": [{k: v for k, v in FLIGHT.items() if k != key}]}


def holed(column: np.ndarray, value: float) -> np.ndarray:
    column = column.copy()
    column[7] = value
    return column


JUMP = TIME + np.where(TIME > 0.5, 0.3, 0.0)
HALF = [
    ("rates in half precision", {"model": Turned(Tensor.half)}, "forward | returns numbers of torch.float16"),
    ("rates in single precision", {"model": Turned(Tensor.float)}, "forward | returns numbers of torch.float32"),
    ("whole numbers for rates", {"model": Turned(Tensor.long)}, "forward | returns numbers of torch.int64"),
    ("a comparison for rates", {"model": Turned(lambda x: x > 0.0)}, "forward | returns numbers of torch.bool"),
]
MODELS: list[tuple[str, dict[str, Any], str]] = [
    *HALF,
    ("a parameter in a list", {"model": Listed()}, "forward | nn.ParameterList"),
    ("no return", {"model": Nothing()}, "forward | returns None"),
    ("yield for return", {"model": Yielding()}, "forward | returns a generator"),
    ("a memory between calls", {"model": Remembering()}, "forward | gives other numbers at each call"),
    ("layers in a row", {"model": nn.Sequential(Lag())}, "output | a method output(x, u)"),
    ("a name for a model", {"model": "Lag"}, "model | is 'Lag'"),
    ("no call of the base class", {"model": Baseless()}, "model | super().__init__()"),
    ("no numbers yet", {"model": Lag().to("meta")}, "a | on the device meta"),
    ("no output", {"model": Outputless()}, "output"),
    ("forward without time", {"model": Timeless()}, "forward"),
    ("NumPy in forward", {"model": WithNumpy()}, "forward"),
    ("NumPy from output", {"model": ToNumpy()}, "output"),
    ("forward gives a pair", {"model": Pair()}, "forward"),
    ("first entry for last", {"model": FirstEntry()}, "forward"),
    ("an attribute that is not there", {"model": Broken()}, "output"),
    ("more outputs than measured", {"model": TwoOutputs()}, "output"),
    ("a parameter as a plain number", {"model": PlainNumber()}, "forward"),
    ("complex parameters", {"model": Complex()}, "a"),
    ("a class", {"model": Lag}, "model"),
    ("a function", {"model": lambda t, x, u: x}, "model"),
    ("None for a model", {"model": None}, "model"),
    ("another order of forward", {"model": OtherOrder()}, "forward | this order: forward(t, x, u)"),
    ("another order of output", {"model": InputsFirst()}, "output | this order: output(x, u)"),
    ("a branch", {"model": Branched()}, "forward | torch.where(condition, a, b) for if"),
    ("a function of math", {"model": OfMath()}, "forward | torch.sin for math.sin"),
    ("a tensor in single precision", {"model": SinglePrecision()}, "forward | register_buffer"),
    ("time with the states", {"model": OfTime()}, "forward | t[..., None] goes with x"),
    ("no parameter", {"model": Bare()}, "model | nn.Parameter"),
    ("a state changed in place", {"model": InPlace()}, "forward | in place"),
    ("an output that is no number at x0", {"model": LogOfNegative()}, "output | gives NaN"),
    ("an output without its last dimension", {"model": WithoutColumns()}, "output | x[..., :1]"),
    ("random numbers in forward", {"model": Gusty()}, "forward | gives other numbers at each call"),
    ("dropout in training", {"model": Layered(nn.Dropout())}, "forward | model.eval()"),
    ("batch norm in training", {"model": Layered(nn.BatchNorm1d(1))}, "forward | model.eval()"),
    ("a parameter in NumPy", {"model": ParameterToNumpy()}, "model | takes a parameter to NumPy"),
    ("a norm of all rows", {"model": OfAllRows()}, "forward | dim=-1"),
    ("a branch on all rows", {"model": OfLargestRow()}, "forward | torch.where(condition, a, b) for if"),
    ("a lazy layer", {"model": Layered(nn.LazyLinear(1))}, "layer.weight | called once"),
    ("a parameter that is NaN", {"model": starting_at(math.nan)}, "a | starts at NaN"),
    ("states as plain numbers", {"model": Plain(states=True)}, "forward | uses x as plain numbers"),
    ("outputs as plain numbers", {"model": Plain(outputs=True)}, "output | uses x as plain numbers"),
    ("a parameter changed by forward", {"model": Clamped()}, "forward | changes a at each call"),
    ("rates on another device", {"model": Turned(lambda x: x.to("meta"))}, "forward | on the device meta"),
    ("a model that cannot be copied", {"model": Locked()}, "model | cannot be copied"),
    ("the matrix before the state", {"model": TransposedProduct()}, "forward | x @ A.mT for A @ x"),
    ("a model in half precision", {"model": Lag().half()}, "a | before .half()"),
    ("a model in brain floats", {"model": Lag().bfloat16()}, "a | is a parameter of torch.bfloat16"),
]
FLIGHTS: list[tuple[str, dict[str, Any], str]] = [
    ("a dict for a list", {"flights": FLIGHT}, "flights"),
    ("None for flights", {"flights": None}, "flights"),
    ("no flights", {"flights": []}, "flights"),
    ("flights by name", {"flights": {"f1": FLIGHT}}, "flights | [flight]"),
    ("a list of lists of flights", {"flights": [[FLIGHT]]}, "flights[0] | is a list"),
    ("a folder for flights", {"flights": "flights"}, "flights | is 'flights'"),
    ("None among flights", {"flights": [FLIGHT, None]}, "flights[1] | is None"),
    ("an interval for time", with_flight(time=0.02), "time | (T,)"),
    ("controls in one dimension", with_flight(controls=STEP), "controls | write a[:, None]"),
    ("stamps of single precision", with_flight(time=(1.7e9 + TIME).astype(np.float32)), "time | does not increase"),
    ("an array for a flight", {"flights": [RESPONSE]}, "flights[0]"),
    ("no outputs", without("outputs"), "outputs"),
    ("a key misspelt", {"flights": [{"output" if k == "outputs" else k: v for k, v in FLIGHT.items()}]}, "outputs"),
    ("None for outputs", with_flight(outputs=None), "outputs"),
    ("None in outputs", with_flight(outputs=[[None], *FLIGHT["outputs"][1:].tolist()]), "outputs"),
    ("outputs in one dimension", with_flight(outputs=RESPONSE), "outputs"),
    ("outputs transposed", with_flight(outputs=RESPONSE[None]), "outputs"),
    ("outputs complex", with_flight(outputs=RESPONSE[:, None] + 0j), "outputs"),
    ("outputs infinite", with_flight(outputs=holed(RESPONSE, math.inf)[:, None]), "outputs"),
    ("no output is there", with_flight(outputs=np.full((60, 1), math.nan)), "outputs"),
    ("text for outputs", with_flight(outputs="q"), "outputs"),
    ("ragged controls", with_flight(controls=[[0.0], [0.0, 1.0], *[[0.0]] * 58]), "controls"),
    ("controls transposed", with_flight(controls=STEP[None]), "controls"),
    ("controls too short", with_flight(controls=STEP[:-1, None]), "controls"),
    ("NaN in controls", with_flight(controls=holed(STEP, math.nan)[:, None]), "controls"),
    ("None for controls", with_flight(controls=None), "controls"),
    ("time stands still", with_flight(time=np.zeros(60)), "time"),
    ("time runs back", with_flight(time=TIME[::-1]), "time"),
    ("time jumps", with_flight(time=JUMP), "time"),
    ("NaN in time", with_flight(time=holed(TIME, math.nan)), "time"),
    ("one sample", with_flight(time=[0.0], controls=[[0.0]], outputs=[[0.0]]), "time"),
    ("other controls in another flight", {"flights": [FLIGHT, FLIGHT | {"controls": np.zeros((60, 2))}]}, "controls"),
    ("other outputs in another flight", {"flights": [FLIGHT, FLIGHT | {"outputs": np.zeros((60, 2))}]}, "outputs"),
    ("x0 of two", with_flight(x0=np.zeros(2)), "model"),
    ("x0 a number", with_flight(x0=0.0), "x0 | write [a]"),
    ("dates for time", with_flight(time=np.datetime64(0, "ms") + np.arange(60)), "time | np.timedelta64(1, 's')"),
    ("a column for time", with_flight(time=TIME[:, None]), "time | write a[:, 0]"),
    ("numbers as text", with_flight(outputs=RESPONSE[:, None].astype(str)), "outputs | a.astype(float)"),
    ("a Flight", {"flights": [rotorid.Flight("roll", 0.02, {"time": torch.as_tensor(TIME)})]}, "flights[0] | arrays("),
    ("x0 of another size in another flight", {"flights": [FLIGHT, FLIGHT | {"x0": np.zeros(2)}]}, "x0"),
    ("x0 infinite", with_flight(x0=[math.inf]), "x0"),
    ("x0 a matrix", with_flight(x0=np.zeros((1, 1))), "x0"),
    ("no x0", without("x0"), "x0"),
    ("controls that are sparse", with_flight(controls=torch.zeros(60, 1).to_sparse()), "controls | .to_dense()"),
    ("outputs without numbers", with_flight(outputs=torch.zeros(60, 1, device="meta")), "outputs | holds no numbers"),
    ("time in microseconds", with_flight(time=1e6 * TIME), "forward | time in seconds"),
    ("a key that nothing reads", with_flight(weights=np.ones(60)), "weights | unknown key"),
    ("states too short", with_flight(states=np.zeros((5, 1))), "states"),
]
OPTIONS: list[tuple[str, dict[str, Any], str]] = [
    ("an unknown parameter", {"free": ["aa"]}, "free"),
    ("a single name", {"free": "a"}, "free"),
    ("nothing free", {"free": []}, "free"),
    ("a delay by the name of a control", {"delays": {"stick": 0.1}}, "delays | by place of the control"),
    ("a delay of all controls", {"delays": 0.1}, "delays | by place of the control"),
    ("None for a bound", {"bounds": {"a": (None, 0.0)}}, "bounds | infinite where there is none"),
    ("a set for bounds", {"bounds": {"a": {-1.0, 1.0}}}, "bounds | is a set"),
    ("angles by name", {"angles": ("phi",)}, "angles | places of outputs"),
    ("parameters for names", {"free": list(Lag().parameters())}, "free | names in quotes, of a, b"),
    ("a start outside bounds", {"bounds": {"a": (-9.0, -5.0)}}, "bounds | a starts at -1"),
    ("a delay in ms", {"delays": {0: 20.0}}, "delays | the longest flight lasts"),
    ("a name twice", {"free": ["a", "a"]}, "free"),
    ("a number for names", {"free": 1}, "free"),
    ("an unknown name in bounds", {"bounds": {"c": (0.0, 1.0)}}, "bounds"),
    ("bounds of what is not free", {"free": ["a"], "bounds": {"b": (0.0, 1.0)}}, "bounds"),
    ("bounds reversed", {"bounds": {"a": (0.0, -1.0)}}, "bounds"),
    ("bounds without room", {"bounds": {"a": (-1.0, -1.0)}}, "bounds | below the upper one"),
    ("one bound", {"bounds": {"a": -1.0}}, "bounds"),
    ("NaN for a bound", {"bounds": {"a": (math.nan, 1.0)}}, "bounds"),
    ("a list for bounds", {"bounds": [(-1.0, 1.0)]}, "bounds"),
    ("x0 none of the words", {"x0": "known"}, "x0"),
    ("numbers for x0", {"x0": [0.0]}, "x0"),
    ("an unknown noise", {"noise": "white"}, "noise"),
    ("a number for noise", {"noise": 0.1}, "noise"),
    ("None for noise", {"noise": None}, "noise"),
    ("noise too large", {"noise": np.eye(2)}, "noise"),
    ("noise by name", {"noise": {"y": 0.1}}, 'noise | "diagonal" or "full"'),
    ("a floor more than outputs", {"noise_floor": [0.1, 0.1]}, "noise_floor | expected (1,)"),
    ("an infinite noise", {"noise": [[math.inf]]}, "noise | finite numbers"),
    ("noise negative", {"noise": [[-1.0]]}, "noise"),
    ("noise singular", {"noise": [[0.0]]}, "noise"),
    ("a number for the floor", {"noise_floor": 0.1}, "noise_floor"),
    ("a negative floor", {"noise_floor": [-0.1]}, "noise_floor"),
    ("True for a floor", {"noise_floor": True}, "noise_floor"),
    ("bounds in words", {"bounds": {"a": ("-5", "0")}}, "bounds | a is ('-5', '0')"),
    ("None in bounds", {"bounds": {"a": (None, 0.0)}}, "bounds | a is (None, 0.0)"),
    ("a number of the model", {"model": OfMass(), "free": ["mass"]}, "free | nn.Parameter"),
    ("a monitor of nothing", {"monitor": lambda: None}, "monitor | monitor(iteration, cost, theta)"),
    ("a class for a monitor", {"monitor": Lag}, "monitor | is the class Lag"),
    ("no iterations", {"max_iterations": -1}, "max_iterations"),
    ("half an iteration", {"max_iterations": 1.5}, "max_iterations"),
    ("a word for a monitor", {"monitor": "print"}, "monitor"),
    ("an angle that is no output", {"angles": [1]}, "angles"),
    ("a number for angles", {"angles": 0}, "angles"),
    ("a delay of a control that there is not", {"delays": {1: 0.02}}, "delays"),
    ("a number for delays", {"delays": 0.02}, "delays"),
    ("a delay below zero", {"delays": {0: -0.02}}, "delays"),
    ("a delay in words", {"delays": {0: "20 ms"}}, "delays"),
]
OUTPUT_ERROR: list[tuple[str, dict[str, Any], str]] = [
    ("a state that there is not", {"x0": {"q": "fixed"}}, "x0"),
    ("a place that there is not", {"x0": {1: "fixed"}}, "x0"),
    ("a wish that there is not", {"x0": {0: "held"}}, "x0"),
    ("a state by name and by place", {"x0": {0: "fixed", "x[0]": (-1.0, 1.0)}}, "x0 | x[0] is given twice"),
    ("bounds of an initial state reversed", {"x0": {0: (1.0, 0.0)}}, "x0"),
    ("one bound of an initial state", {"x0": {0: 1.0}}, "x0"),
    ("no segments", {"segment_lengths": []}, "segment_lengths"),
    ("negative segments", {"segment_lengths": [-1.0]}, "segment_lengths"),
    ("segments of nothing", {"segment_lengths": [0.0]}, "segment_lengths"),
    ("NaN for segments", {"segment_lengths": [math.nan]}, "segment_lengths"),
    ("None for a length", {"segment_lengths": [None]}, "segment_lengths"),
    ("a number for segments", {"segment_lengths": 2.0}, "segment_lengths"),
    ("segments shorter than two samples", {"segment_lengths": [0.01]}, "segment_lengths"),
    ("an unknown solver", {"solver": "rk5"}, "solver"),
    ("a solver in capitals", {"solver": "RK4"}, "solver | did you mean 'rk4'"),
    ("None for the solver", {"solver": None}, "solver"),
    ("an unknown way of controls", {"controls": "zoh"}, "controls"),
    ("an unknown optimiser", {"optimiser": "adam"}, "optimiser"),
]
FILTER_ERROR: list[tuple[str, dict[str, Any], str]] = [
    ("an unknown state", {"process_noise": ["q"]}, "process_noise"),
    ("no state", {"process_noise": []}, "process_noise"),
    ("a word that is none", {"process_noise": "white"}, "process_noise"),
    ("None for process noise", {"process_noise": None}, "process_noise"),
    ("process noise negative", {"process_noise": [[-1.0]]}, "process_noise"),
    ("process noise too large", {"process_noise": np.eye(2)}, "process_noise"),
    ("process noise infinite", {"process_noise": [[math.inf]]}, "process_noise"),
    ("an unknown gain", {"gain": "free"}, "gain"),
    ("an unknown engine", {"engine": "cuda"}, "engine"),
    ("False for an engine", {"engine": False}, "engine"),
    ("process noise by name", {"process_noise": {"x[0]": 0.1}}, "process_noise | a list of states"),
    ("a size of process noise", {"process_noise": 0.1}, "process_noise | write [[a]]"),
]


def ids(table: list[tuple[str, dict[str, Any], str]]) -> list[str]:
    return [row[0] for row in table]


def test_dropout_is_told_whatever_is_drawn() -> None:
    """Two draws are alike for one seed in twenty."""
    for seed in range(100):
        torch.manual_seed(seed)
        with pytest.raises(rotorid.InputError, match="at each call"):
            rotorid.output_error(Layered(nn.Dropout()), [FLIGHT])


@pytest.mark.parametrize(
    "row", MODELS + FLIGHTS + OPTIONS + OUTPUT_ERROR, ids=ids(MODELS + FLIGHTS + OPTIONS + OUTPUT_ERROR)
)
def test_output_error(row: tuple[str, dict[str, Any], str]) -> None:
    one_line(lambda: rotorid.output_error(**({"model": Lag(), "flights": [FLIGHT]} | row[1])), row[2])


OF_FILTER = [row for row in MODELS + FLIGHTS + OPTIONS + FILTER_ERROR]


@pytest.mark.parametrize("row", OF_FILTER, ids=ids(OF_FILTER))
def test_filter_error(row: tuple[str, dict[str, Any], str]) -> None:
    one_line(lambda: rotorid.filter_error(**({"model": Lag(), "flights": [FLIGHT]} | row[1])), row[2])


T = np.arange(200) * 0.05
NOISE = np.random.default_rng(1).standard_normal((2, 200))
X = np.stack([np.sin(T), np.cos(2.3 * T)], axis=-1)
Y = X @ np.array([1.0, -2.0])
REGRESS: list[tuple[str, dict[str, Any], str]] = [
    ("regressors by name", {"regressors": {"q": X[:, 0]}}, "regressors | is a dict"),
    ("names for regressors", {"regressors": ["q", "de"]}, "regressors | holds 'q'"),
    ("stamps for the interval", {"dt": T}, "dt"),
    ("an interval in ms", {"dt": 50.0}, "band | dt is the time between samples, s"),
    ("a band of no width", {"band": (1.0, 1.0)}, "band"),
    ("a band to infinity", {"band": (0.1, math.inf)}, "band"),
    ("more regressors than data", {"regressors": np.random.default_rng(0).standard_normal((200, 60))}, "band"),
    ("two responses and one matrix", {"response": [Y, Y]}, "regressors | as many as responses"),
    ("None for the response", {"response": None}, "response"),
    ("no flight", {"response": [], "regressors": []}, "response"),
    ("text for the response", {"response": "q"}, "response"),
    ("response complex", {"response": Y + 0j}, "response"),
    ("response infinite", {"response": holed(Y, math.inf)}, "response"),
    ("response mostly missing", {"response": np.where(T < 8.0, math.nan, Y)}, "response"),
    ("response all missing", {"response": np.full(200, math.nan)}, "response"),
    ("one sample", {"response": [1.0], "regressors": [[1.0, 2.0]]}, "response"),
    ("a column for the response", {"response": Y[:, None]}, "response | has shape (200, 1)"),
    ("the rate for dt", {"dt": 20.0}, "band | dt is the time between samples"),
    ("regressors transposed", {"regressors": X.T}, "regressors"),
    ("a list of columns", {"regressors": [X[:, 0], X[:, 1]]}, "regressors | np.stack(columns, axis=-1)"),
    ("True for the noise", {"noise": True}, "noise"),
    ("regressors in one dimension", {"regressors": X[:, 0]}, "regressors"),
    ("regressors too short", {"regressors": X[:-1]}, "regressors"),
    ("a dict for regressors", {"regressors": {"q": X[:, 0], "w": X[:, 1]}}, "regressors"),
    ("no regressor", {"regressors": X[:, :0]}, "regressors"),
    ("None in regressors", {"regressors": [[None, 1.0]] * 200}, "regressors"),
    ("other regressors in another flight", {"response": [Y, Y], "regressors": [X, X[:, :1]]}, "regressors"),
    ("fewer regressors than flights", {"response": [Y, Y], "regressors": [X]}, "regressors"),
    ("a response in half precision", {"response": np.float16(Y)}, "response | float64 or float32"),
    ("regressors in half precision", {"regressors": torch.as_tensor(X).half()}, "regressors | float64 or float32"),
    ("dt of zero", {"dt": 0.0}, "dt"),
    ("dt negative", {"dt": -0.05}, "dt"),
    ("None for dt", {"dt": None}, "dt"),
    ("time for dt", {"dt": T}, "dt"),
    ("a word for dt", {"dt": "0.05 s"}, "dt"),
    ("a number for the band", {"band": 2.0}, "band"),
    ("band reversed", {"band": (2.0, 0.1)}, "band"),
    ("band beyond Nyquist", {"band": (0.1, 20.0)}, "band"),
    ("band between harmonics", {"band": (0.11, 0.12)}, "band"),
    ("NaN in the band", {"band": (math.nan, 2.0)}, "band"),
    ("an unknown kind", {"kind": "integral"}, "kind"),
    ("an unknown noise", {"noise": "white"}, "noise"),
    ("negative noise", {"noise": [-0.1, 0.1]}, "noise"),
    ("noise of three for two", {"noise": [0.1, 0.1, 0.1]}, "noise"),
    ("None for noise", {"noise": None}, "noise"),
    ("half an oversampling", {"oversample": 1.5}, "oversample"),
    ("a word for trend", {"trend": "linear"}, "trend"),
    ("three responses of two flights", {"response": np.stack([Y] * 3), "regressors": np.stack([X] * 2)}, "regressors"),
    ("noise by name", {"noise": {"q": 0.1}}, "noise | one per regressor"),
]


@pytest.mark.parametrize("row", REGRESS, ids=ids(REGRESS))
def test_regress(row: tuple[str, dict[str, Any], str]) -> None:
    one_line(
        lambda: rotorid.regress(**({"response": Y, "regressors": X, "dt": 0.05, "kind": "value"} | row[1])), row[2]
    )


def rates(x: Tensor, u: Tensor) -> Tensor:
    return torch.stack([x[..., 1], u[..., 0]], dim=-1)


def height(x: Tensor, u: Tensor) -> Tensor:
    return x[..., :1]


FILTER: dict[str, Any] = {
    "f": rates,
    "h": height,
    "x0": [0.0, 0.0],
    "P0": np.eye(2),
    "Q": np.diag([0.0, 1e-4]),
    "R": [[0.01]],
    "controls": np.zeros((50, 1)),
    "outputs": 0.02 * np.arange(50.0)[:, None],
    "dt": 0.02,
}
UNSCENTED: list[tuple[str, dict[str, Any], str]] = [
    ("an error in f", {"f": lambda x, u: 1 / 0}, "f | division by zero"),
    ("f from torch's list", {"f": lambda x, u: [x[..., 0]]}, "f | torch.stack"),
    ("f with time", {"f": lambda t, x, u: -x}, "f | takes (t, x, u)"),
    ("a name for f", {"f": "f"}, "f | is 'f'"),
    ("no measurement", {"outputs": np.zeros((0, 1)), "controls": np.zeros((0, 1))}, "outputs | hold no value"),
    ("outputs by name", {"outputs": {"q": RESPONSE}}, "outputs | is a dict"),
    ("stamps for the step", {"dt": TIME}, "dt | is an array"),
    ("NaN for the step", {"dt": math.nan}, "dt"),
    ("angles by word", {"angles": "psi"}, "angles | places of outputs"),
    ("None for controls", {"controls": None}, "controls"),
    ("None in outputs", {"outputs": [[None], *[[0.0]] * 49]}, "outputs"),
    ("None for outputs", {"outputs": None}, "outputs"),
    ("outputs transposed", {"outputs": np.zeros((1, 50))}, "controls"),
    ("outputs in one dimension", {"outputs": np.zeros(50)}, "outputs"),
    ("outputs complex", {"outputs": np.zeros((50, 1)) + 0j}, "outputs"),
    ("outputs infinite", {"outputs": np.full((50, 1), math.inf)}, "outputs"),
    ("no output is there", {"outputs": np.full((50, 1), math.nan)}, "outputs"),
    ("controls too short", {"controls": np.zeros((49, 1))}, "controls"),
    ("controls transposed", {"controls": np.zeros((1, 50))}, "controls"),
    ("NaN in controls", {"controls": np.full((50, 1), math.nan)}, "controls"),
    ("time for dt", {"dt": 0.02 * np.arange(50)}, "dt"),
    ("None for dt", {"dt": None}, "dt"),
    ("dt of zero", {"dt": 0.0}, "dt"),
    ("x0 a number", {"x0": 0.0}, "x0"),
    ("x0 of three", {"x0": np.zeros(3)}, "P0"),
    ("x0 with NaN", {"x0": [math.nan, 0.0]}, "x0"),
    ("P0 a vector", {"P0": [1.0, 1.0]}, "P0"),
    ("P0 a number", {"P0": 1.0}, "P0 | a * np.eye(2)"),
    ("P0 not symmetric", {"P0": [[1.0, 0.5], [0.0, 1.0]]}, "P0"),
    ("P0 indefinite", {"P0": np.diag([1.0, -1.0])}, "P0"),
    ("Q a number", {"Q": 1e-4}, "Q"),
    ("Q indefinite", {"Q": np.diag([0.0, -1e-4])}, "Q"),
    ("Q of three", {"Q": np.eye(3)}, "Q"),
    ("R a number", {"R": 0.01}, "R"),
    ("R singular", {"R": [[0.0]]}, "R"),
    ("R of two", {"R": np.eye(2)}, "R"),
    ("x0 a column", {"x0": [[0.0], [0.0]]}, "x0 | has shape (2, 1)"),
    (
        "two flights of controls for three",
        {"controls": np.zeros((2, 50, 1)), "outputs": np.zeros((3, 50, 1))},
        "x0, P0",
    ),
    ("a class for f", {"f": Outputless}, "f | Outputless()"),
    ("f changes in place", {"f": lambda x, u: x.mul_(2.0)}, "f | in place"),
    ("f in half precision", {"f": lambda x, u: rates(x, u).half()}, "f | returns numbers of torch.float16"),
    ("f draws numbers", {"f": lambda x, u: x + torch.randn_like(x)}, "f | gives other numbers at each call"),
    ("h without its last dimension", {"h": lambda x, u: x[..., 0]}, "h | x[..., :1]"),
    (
        "a control that there is not",
        {"f": lambda x, u: torch.stack([x[..., 1], u[..., 1]], dim=-1)},
        "f | there is no entry 1 of 1, for inputs of shapes",
    ),
    ("f takes a mean of all rows", {"f": lambda x, u: rates(x, u) * x.mean()}, "f | dim=-1"),
    ("f branches on all rows", {"f": lambda x, u: rates(x, u) * (2.0 if (x > 9.0).any() else 1.0)}, "f | torch.where"),
    ("f takes time", {"f": lambda t, x, u: x}, "f"),
    ("another order of f", {"f": lambda u, x: x}, "f | this order: f(x, u)"),
    ("a model of output_error for f", {"f": Lag()}, "f | takes (t: 'Tensor', x"),
    ("rows above each other", {"f": lambda x, u: torch.stack([x[..., 1], u[..., 0]])}, "f | dim=-1"),
    ("f takes no controls", {"f": lambda x: x}, "f"),
    ("NumPy in f", {"f": lambda x, u: np.sin(x)}, "f"),
    ("an array of NumPy in f", {"f": lambda x, u: x @ np.eye(2)}, "f | torch.as_tensor(A) for arrays"),
    ("f takes numbers out of x", {"f": lambda x, u: rates(x.detach(), u)}, "f | uses x as plain numbers"),
    ("f gives NumPy", {"f": lambda x, u: x.detach().numpy()}, "f"),
    ("f does not broadcast", {"f": lambda x, u: torch.stack([x[1], u[0]])}, "f"),
    ("f fails", {"f": lambda x, u: x @ torch.eye(3, dtype=torch.float64)}, "f"),
    ("f gives NaN", {"f": lambda x, u: x * math.nan}, "f"),
    ("f gives NaN on the way", {"f": lambda x, u: torch.where(x > 0.1, math.nan, rates(x, u))}, "f"),
    ("f grows where nothing is measured", {"f": lambda x, u: 900.0 * x}, "f, h | other signs in f"),
    ("f grows beyond all numbers", {"f": lambda x, u: 1e9 * (1.0 + x**3)}, "f"),
    ("h gives infinity", {"h": lambda x, u: x[..., :1] / 0.0}, "h"),
    ("h gives two rows", {"h": lambda x, u: x}, "h"),
    ("h gives a list", {"h": lambda x, u: [x[..., 0]]}, "h"),
    ("None for h", {"h": None}, "h"),
    ("a word for smooth", {"smooth": "yes"}, "smooth"),
    ("an angle that is no output", {"angles": (3,)}, "angles"),
    ("a word for angles", {"angles": "psi"}, "angles"),
]


@pytest.mark.parametrize("row", UNSCENTED, ids=ids(UNSCENTED))
def test_unscented_filter(row: tuple[str, dict[str, Any], str]) -> None:
    one_line(lambda: rotorid.unscented_filter(**(FILTER | row[1])), row[2])


def test_parameters_that_ask_for_no_gradient_are_held() -> None:
    model = Lag()
    model.a.requires_grad_(False)
    assert [p.name for p in rotorid.output_error(model, [FLIGHT], x0="fixed").parameters] == ["b"]
    both = rotorid.output_error(model, [FLIGHT], free=["a", "b"], x0="fixed")
    assert [p.name for p in both.parameters] == ["a", "b"]


@pytest.mark.parametrize("estimate", [rotorid.output_error, rotorid.filter_error])
def test_what_is_counted_twice_is_told(estimate: Callable[..., Any]) -> None:
    noisy = FLIGHT | {"outputs": RESPONSE[:, None] + 0.01 * NOISE[0, :60, None]}
    other = FLIGHT | {"outputs": RESPONSE[:, None] + 0.01 * NOISE[1, :60, None]}
    said = [estimate(Lag(), some, x0="fixed", max_iterations=1).message for some in ([noisy, noisy], [noisy, other])]
    assert "flight 1 is a copy of flight 0: counted twice" in said[0]
    assert "copy" not in said[1]
    doubled = noisy | {"outputs": np.repeat(noisy["outputs"], 2, axis=1)}
    message = estimate(TwoOutputs(), [doubled], x0="fixed", max_iterations=1).message
    assert "output 1 is a copy of output 0: counted twice" in message


def test_a_response_among_its_regressors_is_told() -> None:
    columns = np.stack([Y, X[:, 0]], axis=-1)
    said = [rotorid.regress(Y, columns, 0.05, kind=kind).notes for kind in ("value", "derivative")]
    assert any("regressors [0]: are the response itself" in note for note in said[0])
    assert not any("response itself" in note for note in said[1])


def test_a_filter_says_how_large_its_innovations_are_beside_what_it_was_told() -> None:
    """Standard deviations for variances."""
    noise = np.random.default_rng(3).standard_normal((400, 1))
    whole = FILTER | {"controls": np.zeros((400, 1)), "outputs": 0.1 * noise}
    said = [repr(rotorid.unscented_filter(**(whole | {"R": [[r]], "Q": 1e-9 * np.eye(2)}))) for r in (0.01, 0.1)]
    ratios = [float(text.partition("innovations ")[2].partition(" times")[0]) for text in said]
    assert ratios == [pytest.approx(1.0, abs=0.1), pytest.approx(0.316, abs=0.05)]


def test_a_response_that_does_not_move_is_told() -> None:
    for kind in ("value", "derivative"):
        for still in (0.0, 0.1, -1e9):
            found = rotorid.regress(np.full(200, still), X, 0.05, kind=kind)
            assert "does not move" in found.notes[0]
            assert [(row.status, math.isnan(row.se)) for row in found] == 2 * [("not identifiable", True)]


def test_columns_of_one_name_are_refused() -> None:
    pandas = pytest.importorskip("pandas")
    one_line(
        lambda: rotorid.regress(Y, pandas.DataFrame(X, columns=["q", "q"]), 0.05), "regressors | 'q' is given twice"
    )


class NAType:
    """As pandas has it: a missing value of any type."""


def test_what_pandas_writes_for_a_missing_value_is_one() -> None:
    outputs = FLIGHT["outputs"].astype(object)
    holed_too = FLIGHT["outputs"].copy()
    outputs[7, 0], holed_too[7, 0] = NAType(), math.nan
    first, found = (rotorid.output_error(Lag(), [FLIGHT | {"outputs": y}], x0="fixed") for y in (holed_too, outputs))
    assert found["a"].value == first["a"].value
    one_line(lambda: rotorid.output_error(Lag(), [FLIGHT | {"controls": outputs}]), "controls | NaN at [7, 0]")


def test_what_is_said_of_many_parameters_is_short() -> None:
    wide = Layered(nn.Sequential(nn.Linear(1, 60), nn.Linear(60, 1)))
    assert len(repr(rotorid.output_error(wide, 4 * [FLIGHT], x0="fixed", max_iterations=0))) <= 2000


def test_a_result_is_asked_for_what_it_has_not() -> None:
    result = rotorid.output_error(Lag(), [FLIGHT], x0="fixed")
    for name in ("c", "aa", 0, None):
        with pytest.raises(KeyError, match=r"no parameter .*; (did you mean|there are) a"):
            result[name]  # pyright: ignore[reportArgumentType]


PARAMETER: dict[str, Any] = {"name": "x", "value": 0.0, "unit": "1/s", "bounds": (0.0, 5.0)}
PARAMETERS: list[tuple[str, dict[str, Any], str]] = [
    ("None for a name", {"name": None}, "name"),
    ("no name", {"name": ""}, "name"),
    ("None for a unit", {"unit": None}, "x"),
    ("a value in words", {"value": "0.1"}, "x"),
    ("None for a value", {"value": None}, "x"),
    ("NaN for a value", {"value": math.nan}, "x"),
    ("a value beyond the bounds", {"value": 9.0}, "x"),
    ("a usual size beyond the bounds", {"typical": 9.0}, "x"),
    ("a number for bounds", {"bounds": 5.0}, "x"),
    ("None for bounds", {"bounds": None}, "x"),
    ("three bounds", {"bounds": (0.0, 1.0, 2.0)}, "x"),
    ("bounds in words", {"bounds": ("0", "5")}, "x"),
    ("NaN in bounds", {"bounds": (math.nan, 5.0)}, "x"),
    ("bounds reversed", {"bounds": (5.0, 0.0)}, "x"),
]


@pytest.mark.parametrize("row", PARAMETERS, ids=ids(PARAMETERS))
def test_parameter(row: tuple[str, dict[str, Any], str]) -> None:
    one_line(lambda: rotorid.Parameter(**(PARAMETER | row[1])), row[2])


@pytest.mark.parametrize(("name", "unit"), [(None, "rad"), ("", "rad"), (1, "rad"), ("lag", None)])
def test_state(name: Any, unit: Any) -> None:
    one_line(lambda: rotorid.State(name, unit), "State")


@pytest.mark.parametrize(
    "effect",
    [None, "my.drag", object(), nn.Linear, type("Bare", (rotorid.Effect,), {})]
    + [type("Named", (rotorid.Effect,), {"id": name}) for name in (None, 3, "forces.drag")],
)
def test_register(effect: Any) -> None:
    one_line(lambda: rotorid.register(effect), "register")


def test_a_set_of_names_has_the_same_order_in_every_process() -> None:
    names = {f"{letter}{k}" for letter in "dcba" for k in range(9)}
    assert arguments.sequence(arguments.Argument("arguments", "free"), names, "names") == sorted(names)


def test_a_float32_parameter_may_start_on_its_bound() -> None:
    class Lag(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.a = nn.Parameter(torch.tensor(0.1))

        def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
            return u - self.a * x

        def output(self, x: Tensor, u: Tensor) -> Tensor:
            return x

    assert Lag().a.item() > 0.1
    found = rotorid.output_error(Lag(), [FLIGHT], x0="fixed", bounds={"a": (0.0, 0.1)})
    assert 0.0 <= found.parameters[0].value <= 0.1
