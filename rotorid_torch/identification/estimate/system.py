"""A module with forward(t, x, u) and output(x, u) as functions of one vector of free parameters, and derivatives."""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor, nn
from torch.func import functional_call, jvp, vjp, vmap

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.errors import InputError
from rotorid_torch.identification.arguments import bounds_of, module
from rotorid_torch.identification.own_model import OwnModel
from rotorid_torch.model.model import Model

T = TypeVar("T")
PLAIN = "the tensor: no float(), .item(), .detach(), torch.tensor() or NumPy of a parameter"
SAMPLE_POINTS = 128
"""Points at which it is first looked which parameter reaches which row."""
PROBE = 1e-4
"""Part of a parameter by which it is moved to see whether a function depends on it."""
NEAR = 0.1
"""Distance of points about those that are handed in, where states that are not measured stand at zero."""


@dataclass(frozen=True)
class Entry:
    """One free number: the nn.Parameter it lives in, its place there, and what is known of it."""

    name: str
    tensor: str
    place: int
    unit: str
    lower: float
    upper: float


class _Surface(nn.Module):
    """Lets any use of a module run with exchanged parameters."""

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.model = model

    def forward(self, use: Callable[[nn.Module], Any]) -> Any:
        return use(self.model)


class System:
    """A copy of a module in float64, its free numbers as a vector theta [P].

    model : module with forward(t, x, u) -> dx/dt, output(x, u) -> y and, if it likes, tape(controls, dt) -> controls.
    free : names of nn.Parameters (whole tensors, or one entry as "name[i]") or, where the module has a `parameter_set`,
        of entries of its `theta`. None: all that ask for gradients.
    bounds : lower and upper bound by name; a parameter set brings its own.
    around : what stands between the module and the records; its delays are free as well.

    Raises InputError where a name is unknown or given twice, or a parameter starts outside bounds that are given.
    """

    def __init__(
        self,
        model: nn.Module,
        free: Sequence[str] | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        around: Callable[[nn.Module], OwnModel] | None = None,
    ) -> None:
        copied = _copied(module(model)).double().to(torch.get_default_device())
        self.model = copied if around is None else around(copied)
        self._surface = _Surface(self.model)
        self.entries = _entries(self.model, free, bounds or {})
        if not self.entries and free is None:
            wish = "self.name = nn.Parameter(torch.tensor(...)) for each number to estimate"
            raise Argument("arguments", "model").wrong("has no parameter that asks for gradients", wish)
        if not self.entries:
            raise Argument("arguments", "free").wrong("names no parameter", "at least one name of a parameter")
        column = lambda numbers: torch.tensor(numbers, dtype=torch.float64)  # noqa: E731
        self.names = tuple(e.name for e in self.entries)
        self.units = tuple(e.unit for e in self.entries)
        self.lower, self.upper = column([e.lower for e in self.entries]), column([e.upper for e in self.entries])
        tensors = _tensors(self.model)
        self.theta = torch.stack([tensors[e.tensor].detach().reshape(-1)[e.place] for e in self.entries])
        if bounds:
            self._refuse_outside()
        self._whole = {name: p.detach() for name, p in tensors.items()}
        self._places = {name: [i for i, e in enumerate(self.entries) if e.tensor == name] for name in tensors}
        self.has_tape = callable(getattr(self.model, "tape", None))
        self._rates_structure, self._output_structure = (_Structure(of, self.names) for of in ("forward", "output"))

    def _refuse_outside(self) -> None:
        """Raise InputError where a parameter starts outside its bounds by more than what float32 rounds."""
        for k, (entry, value) in enumerate(zip(self.entries, self.theta.tolist(), strict=True)):
            inside = min(max(value, entry.lower), entry.upper)
            if abs(inside - value) > torch.finfo(torch.float32).eps * abs(value):
                wrong = f"{entry.name} starts at {value:g}, outside ({entry.lower:g}, {entry.upper:g})"
                raise Argument("arguments", "bounds").wrong(wrong, "a model that starts within the bounds")
            self.theta[k] = inside

    def at(self, theta: Tensor, use: Callable[[nn.Module], T]) -> T:
        """What `use(model)` gives with the free numbers at theta [P]."""
        values = {f"model.{name}": self._filled(theta, name) for name, places in self._places.items() if places}
        try:
            return functional_call(self._surface, values, (use,))
        except RuntimeError as error:
            if "data pointer" not in str(error):  # which a tensor that carries derivatives has not
                raise
            raise InputError("model", "", "takes a parameter to NumPy, where it has no derivative", PLAIN) from None

    def _filled(self, theta: Tensor, name: str) -> Tensor:
        whole, index = self._whole[name], self._places[name]
        place = torch.tensor([self.entries[i].place for i in index])
        return whole.reshape(-1).index_put((place,), theta[torch.tensor(index)]).view(whole.shape)

    def fitted(self, theta: Tensor) -> nn.Module:
        """A copy of the module with the free numbers at theta."""
        model = copy.deepcopy(self.model)
        with torch.no_grad():
            for name, parameter in _tensors(model).items():
                if self._places[name]:
                    parameter.copy_(self._filled(theta, name))
        return model.model if isinstance(model, OwnModel) else model

    def rates(self, theta: Tensor, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        """dx/dt [..., nx]."""
        return self.at(theta, lambda model: _in_rows(model, t, x, u))

    def output(self, theta: Tensor, x: Tensor, u: Tensor) -> Tensor:
        """Outputs [..., ny]."""
        return self.at(theta, lambda model: _in_rows(model.output, x, u))  # pyright: ignore[reportArgumentType]

    def motion(self, theta: Tensor, t: Tensor, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """Rates and outputs, by one pass through the model where it offers that."""

        def both(model: nn.Module) -> tuple[Tensor, Tensor]:
            if isinstance(model, Model) and (type(model).forward, type(model).output) == (Model.forward, Model.output):
                return model.motion(model.theta, x, u)
            return _in_rows(model, t, x, u), _in_rows(model.output, x, u)  # pyright: ignore[reportArgumentType]

        return self.at(theta, both)

    def tape(self, theta: Tensor, controls: Tensor, dt: float) -> Tensor:
        """The control record [..., T, nu] as the module's control path passes it on."""
        if not self.has_tape:
            return controls
        return self.at(theta, lambda model: model.tape(controls, dt))  # pyright: ignore[reportCallIssue]

    def tape_jacobian(self, theta: Tensor, controls: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Parameters the control path depends on [n], and the derivatives of the record by them [..., T, nu, n]."""
        none = torch.zeros(0, dtype=torch.long), controls.new_zeros(*controls.shape, 0)
        if not self.has_tape:
            return none
        leaf = theta.detach().requires_grad_()
        with torch.enable_grad():
            value = self.tape(leaf, controls, dt)
        if not value.requires_grad:  # nothing that is free acts on the control path
            return none
        # plain autograd: torch's functional one imports a compiler of seconds for its first backward pass
        weights = _random(value.shape, 0).to(value)
        which = torch.autograd.grad(value, leaf, weights, materialize_grads=True)[0].nonzero()[:, 0]
        if len(which) == 0:
            return none
        seeds = torch.eye(len(theta), dtype=theta.dtype)[which]
        return which, _passes(lambda th: self.tape(th, controls, dt), theta, seeds).movedim(0, -1)

    def state_jacobian(self, theta: Tensor, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        """Derivatives of the rates by x [n, nx, nx] at n points."""
        return by_inputs(lambda x, u: self.rates(theta, t, x, u), x, u)[0]

    def rates_jacobian(self, theta: Tensor, t: Tensor, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Derivatives of the rates by x [n, nx, nx], u [n, nx, nu] and theta [n, nx, P] at n points."""
        by_x, by_u = by_inputs(lambda x, u: self.rates(theta, t, x, u), x, u)
        return by_x, by_u, self._rates_structure.jacobian(self.rates, theta, t, x, u)

    def refuse_numbers(self, theta: Tensor, t: Tensor, x: Tensor, u: Tensor) -> None:
        """Refuse a model that uses a parameter without a derivative, as autograd shows it about n points."""
        near = x + NEAR * _random(x.shape, 2).to(x)
        self.rates_jacobian(theta, t, near, u)
        self.output_jacobian(theta, near, u)

    def output_jacobian(self, theta: Tensor, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Derivatives of the outputs by x [n, ny, nx], u [n, ny, nu] and theta [n, ny, P] at n points."""
        by_x, by_u = by_inputs(lambda x, u: self.output(theta, x, u), x, u)
        return by_x, by_u, self._output_structure.jacobian(self.output, theta, x, u)


def _copied(model: nn.Module) -> nn.Module:
    """A copy of a module, which the fit changes in its place."""
    try:
        return copy.deepcopy(model)
    except TypeError as error:  # of what holds a lock, a file or a generator
        wish = "attributes that copy.deepcopy takes: open files, locks and generators outside the model"
        raise Argument("arguments", "model").wrong(f"cannot be copied: {error}", wish) from None


def _in_rows(function: Callable[..., Tensor], *inputs: Tensor) -> Tensor:
    """A function of rows, t [n], x [n, nx], u [n, nu], at any leading dimensions: models may write x[:, 0]."""
    *time, x, u = inputs
    lead = torch.broadcast_shapes(*(t.shape for t in time), x.shape[:-1], u.shape[:-1])
    if len(lead) == 1:
        return function(*inputs)
    count = math.prod(lead)
    rows = [t.expand(lead).reshape(count) for t in time]
    rows += [part.expand(*lead, part.shape[-1]).reshape(count, part.shape[-1]) for part in (x, u)]
    result = function(*rows)
    return result.reshape(*lead, result.shape[-1])


def by_inputs(function: Callable[[Tensor, Tensor], Tensor], x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Derivatives by x and u of a function that treats its rows apart: one backward pass per output, all at once."""
    value, pull, *_ = vjp(function, x, u)
    seeds = torch.eye(value.shape[-1], dtype=value.dtype, device=value.device)
    by_x, by_u = vmap(lambda seed: pull(seed.expand_as(value)))(seeds)
    return by_x.movedim(0, 1), by_u.movedim(0, 1)


def _random(shape: Sequence[int], seed: int) -> Tensor:
    """Normal numbers, the same on every device."""
    generator = torch.Generator("cpu").manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64, device="cpu")


class _Structure:
    """Derivatives by theta in forward mode, parameters that reach different rows sharing one pass.

    Which parameter reaches which row is looked up at sample points; a random direction checks every result, and where
    it disagrees, all parameters are passed one by one and the structure is corrected: the derivatives are exact.

    Source: Curtis, Powell and Reid (1974), J. Inst. Maths Applics 13.
    """

    def __init__(self, method: str, names: Sequence[str]) -> None:
        self.method, self.names = method, names
        self.pattern: Tensor | None = None
        self.group = torch.zeros(0, dtype=torch.long)

    def jacobian(self, function: Callable[..., Tensor], theta: Tensor, *points: Tensor) -> Tensor:
        """[n, rows, P] at points whose leading dimension is n."""
        if self.pattern is None:
            n = len(points[-1])
            pick = torch.linspace(0, n - 1, min(n, SAMPLE_POINTS)).long()
            picked = [p[pick] for p in points]
            self._learn(_passes(function, theta, torch.eye(len(theta), dtype=theta.dtype), *picked))
            self._refuse_numbers(function, theta, *picked)
        result = self._grouped(function, theta, *points)
        if not self._agrees(result, function, theta, *points):
            dense = _passes(function, theta, torch.eye(len(theta), dtype=theta.dtype), *points)
            self._learn(dense)
            result = dense.permute(1, 2, 0)
        return result

    @torch.no_grad()
    def _refuse_numbers(self, function: Callable[..., Tensor], theta: Tensor, *points: Tensor) -> None:
        """Refuse a function that depends on a parameter without a derivative: it took the number out of the tensor."""
        assert self.pattern is not None
        at = function(theta, *points)
        for j in (~self.pattern.any(dim=0)).nonzero()[:, 0].tolist():
            moved = theta.clone()
            moved[j] += PROBE * (1.0 + moved[j].abs())
            moves = bool((function(moved, *points) != at).any() & at.isfinite().all())
            seed = nn.functional.one_hot(torch.tensor([j]), len(theta)).to(theta)
            if moves and not bool(_passes(function, moved, seed, *points).any()):  # theta may be the corner of |k|, k^2
                wrong = f"uses {self.names[j]} as a plain number, and has no derivative by it"
                raise Argument("model", self.method).wrong(wrong, PLAIN)

    def _learn(self, dense: Tensor) -> None:
        """Take nonzero entries of [P, n, rows] into the pattern and group the parameters anew."""
        filled = ((dense != 0) | dense.isnan()).any(dim=1).mT  # [rows, P]
        self.pattern = filled if self.pattern is None else filled | self.pattern
        taken: list[Tensor] = []
        group = [0] * self.pattern.shape[1]
        for j in torch.argsort(self.pattern.sum(0), descending=True).tolist():
            rows = self.pattern[:, j]
            k = next((k for k, other in enumerate(taken) if not bool((other & rows).any())), len(taken))
            if k == len(taken):
                taken.append(torch.zeros_like(rows))
            taken[k] = taken[k] | rows
            group[j] = k
        self.group = torch.tensor(group)

    def _grouped(self, function: Callable[..., Tensor], theta: Tensor, *points: Tensor) -> Tensor:
        assert self.pattern is not None
        row, column = self.pattern.nonzero(as_tuple=True)
        result = theta.new_zeros(len(points[-1]), *self.pattern.shape)
        if len(row):
            seeds = nn.functional.one_hot(self.group).mT.to(theta)
            passes = _passes(function, theta, seeds, *points)
            result[:, row, column] = passes[self.group[column], :, row].mT
        return result

    def _agrees(self, result: Tensor, function: Callable[..., Tensor], theta: Tensor, *points: Tensor) -> bool:
        direction = _random(theta.shape, 1).to(theta) * (1.0 + theta.abs())
        truth = _passes(function, theta, direction[None], *points)[0]
        size = torch.where(truth.isfinite(), truth.abs(), 0.0).amax(dim=0)
        wrong = (result @ direction - truth).abs() > 1e-9 * size
        return not bool((wrong & truth.isfinite()).any())


def _passes(function: Callable[..., Tensor], theta: Tensor, seeds: Tensor, *points: Tensor) -> Tensor:
    """Directional derivatives [k, n, rows] of the values [n, rows] along the seeds [k, P]."""
    return vmap(lambda seed: jvp(lambda th: function(th, *points), (theta,), (seed,))[1])(seeds)


def _entries(model: nn.Module, free: Sequence[str] | None, bounds: Any) -> list[Entry]:
    inner = model.model if isinstance(model, OwnModel) else model
    declared = getattr(inner, "parameter_set", None)
    named_values = _of_set(declared) if declared is not None else _of_tensors(inner)
    delays: list[Entry] = []
    if isinstance(model, OwnModel):
        named_values = {k: [replace(e, tensor=f"model.{e.tensor}") for e in v] for k, v in named_values.items()}
        delays = [Entry(name, "delay", i, "s", low, high) for name, (i, low, high) in model.delays().items()]
        named_values |= {e.name: [e] for e in delays}
    single = {e.name: [e] for group in named_values.values() for e in group}
    argument, first = Argument("arguments", "free"), partial(first_name, inner)
    names = [*named_values, *single]
    if free is None:
        chosen = [name for name in named_values if name not in _held(inner)]
    else:
        free = list(map(first, free)) if isinstance(free, list | tuple) else free
        chosen = [*arguments.names(argument, _parameters_alone(argument, inner, free, names), names, "parameter")]
    chosen += [e.name for e in delays if e.name not in chosen]
    entries = [entry for name in chosen for entry in (named_values[name] if name in named_values else single[name])]
    twice = sorted({e.name for e in entries if sum(o.name == e.name for o in entries) > 1})
    if twice:
        raise argument.wrong(f"'{twice[0]}' is given twice", "each parameter once")
    bounds = {first(name): pair for name, pair in bounds.items()} if isinstance(bounds, Mapping) else bounds
    limits = bounds_of(bounds, list(dict.fromkeys([*chosen, *(e.name for e in entries)])))
    tensors = {e.name: name for name, group in named_values.items() for e in group}
    return [_bounded(e, limits.get(e.name, limits.get(tensors[e.name]))) for e in entries]


def first_name(model: nn.Module, name: Any) -> Any:
    """The name that a parameter goes by, for another name of the same tensor ("b" for "a", "b[0]" for "a[0]")."""
    tensor, bracket, place = str(name).partition("[")
    all_names = dict(model.named_parameters(remove_duplicate=False))
    firsts = {id(one): first for first, one in model.named_parameters()}
    return firsts[id(all_names[tensor])] + bracket + place if tensor in all_names else name


def _held(model: nn.Module) -> set[str]:
    """Names of a module's parameters that do not ask for gradients."""
    return {name for name, tensor in model.named_parameters() if not tensor.requires_grad}


def _parameters_alone(argument: Argument, model: nn.Module, free: Any, names: Sequence[str]) -> Any:
    """Free names, none of which is a number or a buffer of the module."""
    for name in free if isinstance(free, list | tuple) else ():
        if isinstance(name, str) and name not in names and isinstance(getattr(model, name, None), float | int | Tensor):
            value = f"self.{name} = nn.Parameter(torch.tensor(...)) in the model"
            raise argument.wrong(f"{name!r} is a number of the model, no parameter", value)
    return free


def _bounded(entry: Entry, bounds: tuple[float, float] | None) -> Entry:
    return entry if bounds is None else replace(entry, lower=bounds[0], upper=bounds[1])


def _of_set(declared: Any) -> dict[str, list[Entry]]:
    rows = zip(declared.names, declared.units, declared.lower.tolist(), declared.upper.tolist(), strict=True)
    return {n: [Entry(n, "theta", i, unit, low, high)] for i, (n, unit, low, high) in enumerate(rows)}


def _tensors(model: nn.Module) -> dict[str, nn.Parameter]:
    """Tensors that hold the free numbers, by name."""
    vector = getattr(model, "theta", None)
    if getattr(model, "parameter_set", None) is not None and isinstance(vector, nn.Parameter):
        return {"theta": vector}
    return dict(model.named_parameters())


def _of_tensors(model: nn.Module) -> dict[str, list[Entry]]:
    entries = {}
    for name, tensor in model.named_parameters():
        places = [f"{name}[{','.join(map(str, index))}]" for index in np.ndindex(tensor.shape)]
        names = [name] if len(places) == 1 else places
        entries[name] = [Entry(n, name, i, "", -torch.inf, torch.inf) for i, n in enumerate(names)]
    return entries
