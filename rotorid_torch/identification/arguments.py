"""What estimators on anybody's model take: flights, a model that fits them, noises; all else raises InputError."""

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument, Array, Sizes
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.reading.marks import mark_of
from rotorid_torch.errors import InputError, nearest

FLIGHT = (
    Array("time", "T"),
    Array("controls", "T nu"),
    Array("outputs", "T ny", missing=True),
    Array("x0", "nx", optional=True),
    Array("states", "T nx", missing=True, optional=True),
)
"""Arrays of a flight."""
UNEVEN = 0.01
"""Of the sample interval by which samples may be early or late."""
RATES_FORM = "forward(t, x, u) -> dx/dt"
OUTPUT_FORM = "output(x, u) -> y"
SOLVERS = ("rk4", "euler", "midpoint", "heun3", "dopri5", "dopri8", "bosh3", "fehlberg2", "adaptive_heun")
"""Of torchdiffeq: explicit methods."""


def flights_of(flights: Any) -> list[dict[str, Tensor]]:
    """The arrays of each flight: sizes of controls, outputs and states are those of the first flight.

    Raises InputError: no list of dicts, an array that is absent or does not fit, or time that does not run evenly.
    """
    argument, wish = Argument("arguments", "flights"), "a list of dicts with time, controls, outputs, x0: [flight]"
    listed = arguments.sequence(argument, flights, wish)
    if not listed:
        raise argument.wrong("is empty", "one dict per flight with time, controls, outputs, x0")
    common, rows = Sizes(), []
    for i, flight in enumerate(listed):
        if isinstance(flight, Flight):
            wish = "flight.arrays(controls=[...], outputs=[...], x0=[...]), with names of channels"
            raise InputError(f"flights[{i}]", "", f"is the Flight {flight.name}", wish)
        sizes = common.without("T")
        row = arguments.arrays(f"flights[{i}]", FLIGHT, flight, sizes)
        _refuse_uneven(Argument(f"flights[{i}]", "time"), row["time"])
        _refuse_marks(Argument(f"flights[{i}]", "outputs"), row["outputs"])
        common = sizes
        rows.append(row)
    return rows


def _refuse_uneven(argument: Argument, time: Tensor) -> None:
    if len(time) < 2:
        raise argument.wrong(f"has {len(time)} sample", "at least two samples")
    step = torch.diff(time)
    if not bool((step > 0).all()):
        k = int((step <= 0).nonzero()[0])
        raise argument.wrong(f"does not increase from sample {k} to {k + 1}", "seconds that increase")
    mean = float(step.mean())
    if float((step - mean).abs().max()) > UNEVEN * mean:
        wish = f"equal ones (within {UNEVEN:.0%}): resample, or cut where samples are lost"
        raise argument.wrong(f"has intervals of {float(step.min()):.4g} to {float(step.max()):.4g} s", wish)


def _refuse_marks(argument: Argument, outputs: Tensor) -> None:
    """Outputs [T, ny] of which one jumps to the same value and back: no model follows it there."""
    for column, values in enumerate(outputs.T.detach().cpu().numpy()):
        if (mark := mark_of(values)) is not None:
            wrong = f"jump to {mark:g} and back in column {column} ({int((values == mark).sum())} samples)"
            raise argument.wrong(wrong, "NaN where nothing was measured")


def refuse_unmeasured(outputs: Tensor) -> None:
    """Outputs of all flights [F, T, ny] of which one has no value anywhere.

    Raises InputError naming the column.
    """
    nothing = outputs.isnan().flatten(0, -2).all(dim=0).nonzero()[:, 0].tolist()
    if nothing:
        which = "no value at all" if len(nothing) == outputs.shape[-1] else f"no value in column {nothing[0]}"
        raise Argument("flights", "outputs").wrong(f"hold {which}, in any flight", "measured outputs, or fewer columns")


def refuse_too_few(outputs: Tensor, parameters: int, states: int) -> None:
    """Fewer measured outputs [F, T, ny] than unknowns: parameters, and initial states of each flight."""
    values, unknowns = int((~outputs.isnan()).sum()), parameters + states * len(outputs)
    if values <= unknowns:
        wrong = f"hold {values} values for {unknowns} unknowns ({parameters} parameters, the others initial states)"
        raise Argument("flights", "outputs").wrong(wrong, 'longer flights, fewer names in free, or x0="fixed"')


def module(model: Any) -> nn.Module:
    """A module of torch with real parameters, a forward and an output."""
    argument = Argument("arguments", "model")
    if type(model).__name__ == "OptimizedModule":  # of torch.compile: native code is made of the module itself
        model = model._orig_mod
    if not isinstance(model, nn.Module):
        call = f": {model.__name__}()" if isinstance(model, type) else ""
        wish = f"a torch.nn.Module with {RATES_FORM} and {OUTPUT_FORM}{call}"
        raise argument.wrong(f"is {arguments.described(model)}", wish)
    if "_parameters" not in vars(model):
        raise argument.wrong("has no parameters of torch", "super().__init__() as the first line of its __init__")
    if not callable(getattr(model, "output", None)):
        raise Argument("model", "output").wrong("absent", f"a method {OUTPUT_FORM}, shape (..., ny)")
    for name, parameter in model.named_parameters():
        if isinstance(parameter, nn.parameter.UninitializedParameter):
            raise Argument("model", name).wrong("has no shape yet", "a lazy module that was called once")
        if parameter.is_meta or parameter.layout != torch.strided:
            wrong = f"is a {parameter.layout} tensor on the device {parameter.device}"
            raise Argument("model", name).wrong(wrong, "a dense one that holds numbers")
        if not parameter.is_floating_point():
            raise Argument("model", name).wrong(f"is a parameter of {parameter.dtype}", "a real one")
        if parameter.dtype not in (torch.float32, torch.float64):
            wish = "float32 or float64, made before .half(): the fit is in float64, and digits that are lost stay lost"
            raise Argument("model", name).wrong(f"is a parameter of {parameter.dtype}", wish)
        if not bool(parameter.detach().isfinite().all()):
            raise Argument("model", name).wrong("starts at NaN or infinity", "finite numbers to start from")
    return model


def state_names(model: nn.Module, nx: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of a module's states."""
    layout, named = getattr(model, "layout", None), getattr(model, "states", None)
    if layout is not None and len(layout) == nx:
        return layout.names, tuple(s.unit for s in layout.states)
    if isinstance(named, Sequence) and not isinstance(named, str) and len(named) == nx:
        return tuple(str(name) for name in named), ("",) * nx
    return tuple(f"x[{i}]" for i in range(nx)), ("",) * nx


def refuse_unfit(model: nn.Module, start: Tensor, x: Tensor, u: Tensor, ny: int) -> None:
    """A model that does not take the flights' states [F, nx] and controls [F, nu], or gives something else.

    x : NaN where a flight does not say it; there zeros are tried, of which nothing is asked but the shape.

    Raises InputError naming the method.
    """
    count = sum((x.shape[-1], u.shape[-1], ny, 2))
    rows = torch.arange(max(len(x), count)) % len(x)
    said, t, x, u = ~x[rows].isnan().any(dim=-1), start[rows], x[rows].nan_to_num(0.0), u[rows]
    sizes = f" (x0 has {x.shape[-1]} numbers, controls have {u.shape[-1]} columns, outputs have {ny})"
    output: Any = model.output
    for key, function, inputs, n, form in (
        ("forward", model.forward, (t, x, u), x.shape[-1], RATES_FORM),
        ("output", output, (x, u), ny, OUTPUT_FORM),
    ):
        argument = Argument("model", key)
        result = arguments.evaluated(argument, function, inputs, (*x.shape[:-1], n), form + sizes)
        if not bool(result[said].isfinite().all()):
            raise argument.wrong("gives NaN or infinity at x0 and the first controls", f"numbers; {form}")
        if _asks_beside(model, function, inputs):
            wish = "nn.ParameterList for a list of parameters, nn.ModuleList for one of modules; .detach() of numbers"
            raise argument.wrong("uses a tensor that asks for gradients and is no parameter of the model", wish)


def _asks_beside(model: nn.Module, function: Callable[..., Tensor], inputs: Sequence[Tensor]) -> bool:
    """Whether what a module gives asks for gradients where none of its parameters does."""
    held = (parameter for part in model.modules() for parameter in part._parameters.values())
    asking = [one for one in held if one is not None and one.requires_grad]  # a model's own names may be of copies
    with torch.enable_grad():
        try:
            for parameter in asking:
                parameter.requires_grad_(False)
            return function(*inputs).requires_grad
        finally:
            for parameter in asking:
                parameter.requires_grad_(True)


def noise_of(noise: Any, ny: int) -> tuple[str, Tensor | None]:
    """How the outputs' noise comes about: "diagonal" or "full", or "held" with a matrix [ny, ny]."""
    argument = Argument("arguments", "noise")
    if arguments.is_word(noise):
        return arguments.word(argument, noise, ("diagonal", "full"), f" or a covariance ({ny}, {ny})"), None
    return "held", arguments.covariance(argument, noise, f"{ny} {ny}", Sizes(), definite=True)


def floor_of(noise_floor: Any, ny: int) -> Tensor | None:
    """Standard deviations [ny] below which no noise is believed, or None.

    Raises InputError: another number of them, or a negative one.
    """
    if noise_floor is None:
        return None
    argument = Argument("arguments", "noise_floor")
    floor = arguments.shaped(argument, noise_floor, str(ny), Sizes())
    if bool((floor < 0).any()):
        raise argument.wrong(f"is {floor.tolist()}", f"{ny} standard deviations, none negative")
    return floor


def lengths_of(segment_lengths: Any, dt: float) -> tuple[float, ...] | None:
    """Lengths of segments in seconds, stage by stage; infinite for whole flights.

    Raises InputError: none, or one that is no number or holds fewer than two samples.
    """
    if segment_lengths is None:
        return None
    argument = Argument("arguments", "segment_lengths")
    expected = f"a list of seconds of at least two samples ({2 * dt:.4g} s), float('inf') for whole flights"
    lengths = arguments.sequence(argument, segment_lengths, expected)
    wrong = [value for value in lengths if isinstance(value, bool | str) or not _long_enough(value, dt)]
    if wrong or not lengths:
        raise argument.wrong(f"holds {arguments.described(wrong[0])}" if wrong else "is empty", expected)
    return tuple(map(float, lengths))


def _long_enough(value: Any, dt: float) -> bool:
    try:
        return float(value) >= 1.5 * dt
    except (TypeError, ValueError, RuntimeError):
        return False


def angles_of(of: str, angles: Any, ny: int) -> tuple[int, ...]:
    """Places of outputs that are angles.

    Raises InputError: no list of places that there are.
    """
    argument = Argument(of, "angles")
    expected = f"a list of places of outputs, 0 to {ny - 1}"
    return tuple(_place(argument, place, ny, expected) for place in arguments.sequence(argument, angles, expected))


def delays_of(delays: Any, nu: int, longest: float) -> dict[int, float]:
    """Where pure delays start, s, by place of the control; `longest` is the length of the longest flight, s.

    Raises InputError: no dict of delays by places that there are, one below zero, or one as long as any flight.
    """
    argument, expected = Argument("arguments", "delays"), f"a dict of seconds by place of the control, 0 to {nu - 1}"
    if delays is None:
        return {}
    arguments.instance(argument, delays, Mapping, expected)
    by_place = {_place(argument, place, nu, expected): delay for place, delay in delays.items()}
    for place, delay in by_place.items():
        if arguments.number(argument, delay, "a delay, s", least=0.0) >= longest:
            wrong = f"has {delay:g} s of control {place}, the longest flight lasts {longest:.4g} s"
            raise argument.wrong(wrong, "a delay in s")
    return {place: float(delay) for place, delay in by_place.items()}


def _place(argument: Argument, place: Any, count: int, expected: str) -> int:
    whole = -1
    if not isinstance(place, bool):
        with suppress(TypeError, RuntimeError):  # the last is torch's, of what is no single whole number
            whole = operator.index(place)
    if not 0 <= whole < count:
        raise argument.wrong(f"has {place!r}", expected)
    return whole


@dataclass(frozen=True)
class InitialStates:
    """How initial states are treated: "free" or "fixed" as a whole; of a free one, which are believed, and bounds."""

    whole: str
    held: Tensor | None = None  # [nx]
    bounds: tuple[Tensor, Tensor] | None = None  # [nx]


def initial_states_of(x0: Any, names: Sequence[str]) -> InitialStates:
    """What `x0` asks for: a word, or by place or name of a state "free", "fixed" or (lower, upper).

    Raises InputError: a state that there is not, or another wish.
    """
    argument = Argument("arguments", "x0")
    if not isinstance(x0, Mapping):
        return InitialStates(arguments.word(argument, x0, ("free", "fixed"), ", or a dict of them by state"))
    held = torch.zeros(len(names), dtype=torch.bool)
    low, high = torch.full((len(names),), -math.inf, dtype=torch.float64), torch.full((len(names),), math.inf)
    expected, places = f"one of {arguments.listed(names)}, or its place", list[int]()
    for key, wish in x0.items():
        place = names.index(key) if key in names else _place(argument, key, len(names), expected)
        if place in places:
            raise argument.wrong(f"{names[place]} is given twice", "each state once, by its name or its place")
        places.append(place)
        if isinstance(wish, str):
            held[place] = arguments.word(argument, wish, ("free", "fixed"), " or (lower, upper)") == "fixed"
        else:
            low[place], high[place] = _pair(argument, str(key), wish)
    bounded = bool((low.isfinite() | high.isfinite()).any())
    return InitialStates("free", held if bool(held.any()) else None, (low, high.to(low)) if bounded else None)


def refuse_search(max_iterations: Any, monitor: Any) -> None:
    """Iterations that are no number of them, or a monitor that cannot be called."""
    arguments.number(Argument("arguments", "max_iterations"), max_iterations, least=0, whole=True)
    if monitor is not None:
        arguments.refuse_signature(Argument("arguments", "monitor"), monitor, 3, "monitor(iteration, cost, theta)")


def bounds_of(bounds: Any, free: Sequence[str]) -> Mapping[str, tuple[float, float]]:
    """Lower and upper bound by name of a free parameter.

    Raises InputError: a name that is not free, or no pair with the lower bound first.
    """
    argument = Argument("arguments", "bounds")
    if bounds is None:
        return {}
    if not isinstance(bounds, Mapping):
        raise argument.wrong(f"is {arguments.described(bounds)}", "a dict of (lower, upper) by name")
    checked = {}
    for name, pair in bounds.items():
        if name not in free:
            hint = nearest(str(name), free)
            raise argument.wrong(f"{name!r} is no free parameter{hint}", f"one of {arguments.listed(free)}")
        checked[name] = _pair(argument, name, pair)
    return checked


def _pair(argument: Argument, name: str, pair: Any) -> tuple[float, float]:
    expected = "(lower, upper), infinite where there is none"
    entries = list(pair) if isinstance(pair, tuple | list) else []
    said = f"({', '.join(map(arguments.described, entries))})" if entries else arguments.described(pair)
    try:
        low, high = (math.nan if isinstance(bound, str) else float(bound) for bound in pair)
    except (TypeError, ValueError, RuntimeError):
        raise argument.wrong(f"{name} is {said}", expected) from None
    if not low < high:
        raise argument.wrong(f"{name} is {said}", f"{expected}, lower bound first and below the upper one")
    return low, high
