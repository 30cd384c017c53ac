"""What an effect of a user promises, tried on a few points of the vehicle's model before any work begins.

Each mistake is an InputError with the effect's id, where the effect fails, what is wrong, and what was expected.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from typing import Any, NoReturn

import numpy as np
import torch
from torch import Tensor

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.core.parameters import Parameter, ParameterSet
from rotorid_torch.core.state import State, StateLayout
from rotorid_torch.effects.base import Effect, Frame, Role, Showing, Stage, Values
from rotorid_torch.effects.registry import of_others, registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.effects.weights import refuse_foreign
from rotorid_torch.errors import InputError
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.model.training.equilibrium import equilibrium

ID = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)+")
POINTS, SAMPLES, DT = 5, 40, 0.02
"""Points of the state space, samples of a record, and their interval, s, that an effect is tried on."""
EXACT = 1e-9
"""Share of the size of rates and outputs that rounding may change."""
AWAY = 0.1
"""By how much parameters are moved from their null, in their units, within their bounds."""
SETTLED = 1e-3
"""Rate of a state at rest over its rate where it starts: what four steps of Newton's method may leave."""


def refuse_faulty(effects: Iterable[str], spec: ModelSpec) -> None:
    """Refuse effects that break what they promise, on the model of a vehicle.

    Effects that say that they cannot be tested on the vehicle, or that the model has them already, pass.

    Raises InputError: an effect's class, its parameters or states, its null, its shapes, or an error that it raises.
    """
    without: Model | None = None
    for name in effects:
        effect = registered()[name]
        _refuse_class(name, effect)
        with _blamed(name, "untestable and within"):
            if effect.untestable(spec) is not None or effect.within(spec):
                continue
        without = without or _somewhere(build(spec))
        with _blamed(name, "from_spec"):
            returned = effect.from_spec(spec)
        _refuse_declaration(name, returned)
        with _blamed(name, "from_spec"):
            model = build(spec.with_effects(name), without.named_values)
        refuse_foreign(_of(model, name), _of(model, name).network_weights, name)
        _refuse_behaviour(name, model, without)


def extended(model: Model, spec: ModelSpec, effects: Sequence[str]) -> Model:
    """A model of a spec with more effects, started at its numbers.

    Raises InputError: an effect that there is not, or one of a user that breaks what it promises.
    """
    names = arguments.names(Argument("with_effects", "effects"), effects, sorted(registered()), "effect")
    refuse_faulty([name for name in names if name in of_others()], spec)
    return build(spec.with_effects(*names), model.named_values)


def _refuse(name: str, where: str, wrong: str, expected: str) -> NoReturn:
    raise InputError(f"effect {name}", where, wrong, expected)


@contextmanager
def _blamed(name: str, where: str, signals: Iterable[str] = ()) -> Iterator[None]:
    """Any error of a block as one of the effect."""
    try:
        yield
    except InputError as error:
        if error.file not in ("Parameter", "State"):
            raise
        _refuse(name, where, f"{error.key}: {error.wrong}", error.expected)
    except KeyError as error:
        _refuse(name, where, f"asks for {error}, which is no signal of this model", f"one of {', '.join(signals)}")
    except Exception as error:  # the effect is somebody else's code, and may fail in any way
        said = str(error).strip().partition("\n")[0]
        if any(word in said for word in ("Boolean value", "data-dependent", "converted to Scalar", ".item()")):
            _refuse(name, where, f"a number is asked of a tensor ({said})", "torch.where for if, and no .item()")
        if words := arguments.in_words(said):
            _refuse(name, where, words, 'tensors [..., n]; a parameter goes with a vector as p["name"][..., None]')
        if advice := arguments.advice(said):
            _refuse(name, where, *advice)
        _refuse(name, where, f"{type(error).__name__}: {said}", "code that runs, through torch's operations")


def _refuse_class(name: str, effect: type[Effect]) -> None:
    if not ID.fullmatch(name):
        _refuse(name, "id", "is no id", "words of letters, digits and underscores with a dot between, as my.drag")
    for other in registered():
        if other.startswith(f"{name}.") or name.startswith(f"{other}."):
            _refuse(name, "id", f"of this and {other} one is the beginning of the other", "ids that differ before that")
    for key, kind in (("stage", Stage), ("role", Role), ("showing", Showing)):
        if not isinstance(getattr(effect, key), kind):
            members = ", ".join(f"{kind.__name__}.{one.name}" for one in kind)
            _refuse(name, key, f"is {getattr(effect, key)!r}", f"one of {members}")
    if effect.tape is not Effect.tape and effect.stage not in (Stage.CONTROL, Stage.SENSORS):
        wrong = f"is called of controls and sensors alone, and the stage is {effect.stage.name}"
        _refuse(name, "tape", wrong, "Stage.CONTROL or Stage.SENSORS, or forward")
    if effect.role is Role.NOMINAL:
        _refuse(name, "role", "is Role.NOMINAL, which the model has from the start", "UNDECLARED or STRUCTURE")


def _refuse_declaration(name: str, returned: Any) -> None:
    if not isinstance(returned, Effect):
        _refuse(name, "from_spec", f"returns {type(returned).__name__}", "an effect")
    for key, kind in (("declared", Parameter), ("states", State)):
        entries = getattr(returned, key, None)  # which super().__init__ sets
        if not isinstance(entries, tuple) or not all(isinstance(one, kind) for one in entries):
            wish = f"a tuple of {kind.__name__}, as super().__init__(declared, states) takes it"
            _refuse(name, key, f"is {entries!r}", wish)
    with _blamed(name, "parameters"):
        ParameterSet(returned.declared)
    with _blamed(name, "states"):
        StateLayout(returned.states)
    arguments.refuse_signature(Argument(f"effect {name}", "forward"), returned.forward, 3, "forward(frame, x, p)")
    if not returned.declared:
        held = "a module that the effect holds: self.net, or nn.ModuleList for a list"
        _refuse(name, "parameters", "none is declared", f"one whose declared value changes nothing, or {held}")


def _somewhere(model: Model) -> Model:
    """The model with derivatives other than zero, drawn."""
    chance = torch.Generator().manual_seed(0)
    drawn = 0.1 * torch.randn(len(model.theta), generator=chance, dtype=torch.float64)
    model.start_from(dict(zip(model.parameter_set.names, (model.theta.detach() + drawn).tolist(), strict=True)))
    return model


def _refuse_behaviour(name: str, model: Model, without: Model) -> None:
    """Shapes and errors first, then the null, derivatives by the parameters, and the rest of the states."""
    asked = _watch(name, model)
    place, names = model.chain.index(_of(model, name)), without.layout.names
    signals = (*model.layout.names, *model.body.controls)
    x, u = _points(model)

    def everything(of: Model, x: Tensor) -> dict[str, Tensor]:
        theta = of.theta.detach()
        rates, outputs = of.rates(theta, x, u)[..., of.layout.places(names)], of.outputs_at(theta, x, u)
        results = {f"the rate of {n}": rates[..., k] for k, n in enumerate(names)}
        results |= {f"the output {n}": outputs[..., k] for k, n in enumerate(of.body.outputs)}
        results["the controls' record"] = of.tape(_record(of.body.controls), DT)
        results["the outputs' record"] = of.recorded(_record(of.body.outputs), DT)
        return results

    effect, theta = model.chain[place], model.theta.detach()
    where = "tape" if effect.stage is Stage.CONTROL else "forward"
    with _blamed(name, where, signals), torch.no_grad():
        originals = x.clone(), u.clone()
        now, before = everything(model, x), everything(without, x[..., model.layout.places(names)])
        if not (torch.equal(originals[0], x) and torch.equal(originals[1], u)):
            _refuse(name, where, "changes the signals that it is handed in place", "new tensors")
        several = theta.repeat(2, 1)[:, None]
        model.rates(several, x, u)
        model.rates(theta, x[0], u[0])
        effect.tape(_record(model.body.controls), model.body.controls, DT, model.values(several, place))
    for what, value in now.items():
        usual = before[what]
        if not bool((value.isfinite() | ~usual.isfinite()).all()):
            _refuse(name, where, f"makes {what} infinite or NaN at its declared values", "finite numbers there")
        change = float((value - usual).nan_to_num(0.0).abs().max())
        if change > EXACT * max(1.0, float(usual.nan_to_num(0.0).abs().max())):
            wrong = f"changes {what} by {change:.2g} at its declared values"
            wish = "declared values at which it changes nothing; of a network, nn.init.zeros_ on its last layer"
            _refuse(name, where, wrong, wish)
    with _blamed(name, where, signals):
        slopes = torch.func.jacfwd(lambda th: torch.cat([model.rates(th, x, u), model.outputs_at(th, x, u)], -1))(theta)
    for i, parameter in enumerate(model.parameter_set.names):
        if parameter.startswith(f"{name}.") and not bool(slopes[..., i].isfinite().all()):
            _refuse(name, where, f"has no finite derivative by {parameter} at its declared value", "a finite one")
    weights = sum(weight.count for weight in effect.network_weights)
    random = effect.showing is Showing.INNOVATIONS  # of which neither forward nor tape knows
    for one in effect.declared[: 0 if random else len(effect.declared) - weights]:
        if one.name not in asked and not bool(slopes[..., model.parameter_set.index(f"{name}.{one.name}")].any()):
            wish = f'p["{one.name}"] in forward, or in tape; or no such parameter'
            _refuse(name, one.name, "is declared, and no method of the effect uses it", wish)
    _refuse_mixing(name, model, x, u)
    _refuse_untrained(name, model, x, u)
    _refuse_restless(name, model, x, u)


@torch.no_grad()
def _refuse_mixing(name: str, model: Model, x: Tensor, u: Tensor) -> None:
    """Refuse an effect of which a point depends on the others, tried where its parameters are not at their null."""
    if arguments.branches(lambda x, u: model.motion(model.theta, x, u), (x, u)):
        _refuse(name, "forward", *arguments.ONE_NUMBER)
    mine = torch.tensor([one.startswith(f"{name}.") for one in model.parameter_set.names])
    theta = model.parameter_set.clamp(torch.where(mine, model.theta + AWAY, model.theta))
    together = torch.cat([model.rates(theta, x, u), model.outputs_at(theta, x, u)], dim=-1)
    points = zip(x.split(1), u.split(1), strict=True)
    alone = torch.cat([torch.cat([model.rates(theta, *at), model.outputs_at(theta, *at)], dim=-1) for at in points])
    if not torch.allclose(alone, together, EXACT, EXACT * float(together.nan_to_num().abs().max()), equal_nan=True):
        wish = "each point by itself: dim=-1 in norms and means, torch.where for if"
        _refuse(name, "forward", "gives a point of a batch other numbers than the same point alone", wish)


def _refuse_untrained(name: str, model: Model, x: Tensor, u: Tensor) -> None:
    """Refuse a tensor that waits for gradients outside the parameters, and weights that nothing depends on."""
    try:
        model.refuse_untrained()
    except InputError as error:
        _refuse(name, error.key, error.wrong, error.expected)
    effect = _of(model, name)
    if not effect.network_weights:
        return
    first = next(i for i, n in enumerate(model.parameter_set.names) if n.startswith(f"{name}."))
    first += len(effect.declared) - sum(w.count for w in effect.network_weights)
    last = first + sum(w.count for w in effect.network_weights)
    drawn = torch.randn(last - first, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    with torch.no_grad():
        model.theta[first:last] = 0.3 * drawn  # elsewhere than where a last layer of zeros hides the others
    results = [*model.motion(model.theta, x, u), model.tape(_record(model.body.controls), DT)]
    results.append(model.recorded(_record(model.body.outputs), DT))
    used = [r.nan_to_num(0.0).square().sum() for r in results if r.requires_grad]
    (slopes,) = torch.autograd.grad(used, model.theta)
    for weight in effect.network_weights:
        if not bool(slopes[first : first + weight.count].any()):
            wrong = "nothing depends on it, so that it would not be trained"
            _refuse(name, weight.name, wrong, "a module that forward or tape uses")
        first += weight.count


def _refuse_restless(name: str, model: Model, x: Tensor, u: Tensor) -> None:
    """Refuse a state that rests nowhere and starts at no channel."""
    body = x[:, : len(model.body.states)]
    with _blamed(name, "states"), torch.no_grad():
        nowhere = torch.tensor([model.reference.get(n, 0.0) for n in model.layout.names], dtype=torch.float64)
        start = torch.cat([body, nowhere[len(model.body.states) :].expand(len(x), -1)], dim=-1)
        before, after = (model.rates(model.theta, at, u).abs() for at in (start, equilibrium(model, body, u)))
    for k, state in enumerate(model.layout.states):
        if not state.name.startswith(f"{name}.") or state.channel is not None:
            continue
        if not float(after[:, k].max()) <= SETTLED * max(1.0, float(before[:, k].max())):
            wrong = "rests at no value: its rate does not vanish"
            _refuse(name, state.name, wrong, "a rate that depends on the state, or the channel that it starts at")


def _of(model: Model, name: str) -> Effect:
    effect = model.effect(name)
    assert effect is not None
    return effect


def _watch(name: str, model: Model) -> set[str]:
    """Let the effect in the model be refused where what it returns has another kind or shape than it promises.

    Returns the names of the parameters that it has asked for, as they come.
    """
    effect, asked = _of(model, name), set[str]()
    forward, tape, read, watched = effect.forward, effect.tape, effect.read, _watched(name)

    class Asked(Values):
        """Parameters that are noted where they are asked for."""

        def _place(self, name: str) -> int:
            asked.add(name)
            return super()._place(name)

    Asked.__name__ = Values.__name__

    def forwarded(frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        parts = {one.name: getattr(frame, one.name) for one in fields(Frame)}
        returned: Any = forward(watched(**parts), x, Asked(p.vector, p.names))
        if not (isinstance(returned, tuple) and len(returned) == 2 and isinstance(returned[0], Frame)):
            _refuse(name, "forward", "returns no pair", "a Frame and the rates of its states")
        if not isinstance(returned[1], Tensor) or returned[1].shape[-1:] != x.shape[-1:]:
            shape = tuple(returned[1].shape) if isinstance(returned[1], Tensor) else type(returned[1]).__name__
            _refuse(name, "forward", f"rates are {shape}", f"[..., {x.shape[-1]}], one of each state")
        for signal, entry in returned[0].signals.items():
            _refuse_shape(name, f"signal {signal}", entry, tuple(returned[0].signals["p"].shape))
        return Frame(**{one.name: getattr(returned[0], one.name) for one in fields(Frame)}), returned[1]

    def recorded(of: str, function: Callable[..., Any]) -> Callable[..., Tensor]:
        def passed(record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
            returned = function(record, names, dt, Asked(p.vector, p.names))
            if not isinstance(returned, Tensor) or returned.shape[-2:] != record.shape[-2:]:
                shape = tuple(returned.shape) if isinstance(returned, Tensor) else type(returned).__name__
                _refuse(name, of, f"returns {shape}", f"a record {tuple(record.shape)}, as it is handed")
            return returned

        return passed

    effect.forward = forwarded
    effect.tape, effect.read = recorded("tape", tape), recorded("read", read)
    return asked


def _watched(name: str) -> type[Frame]:
    """A frame that refuses loads of another shape."""

    class Watched(Frame):
        def add(self, force: Tensor | None = None, moment: Tensor | None = None) -> Frame:
            """The same frame with these added."""
            shape = (*self.signals["p"].shape, 3)
            _refuse_shape(name, "force", force, shape)
            _refuse_shape(name, "moment", moment, shape)
            return super().add(force, moment)

    Watched.add.__qualname__ = "Frame.add"  # an error that names them names what the page describes
    Watched.__name__ = Frame.__name__
    return Watched


def _refuse_shape(name: str, what: str, entry: Any, shape: tuple[int, ...]) -> None:
    """Refuse what is no tensor of a shape, further leading dimensions aside; None is nothing added."""
    if entry is None:
        return
    if not isinstance(entry, Tensor):
        _refuse(name, what, f"is {type(entry).__name__}", f"a tensor {shape}")
    if entry.dtype != torch.float64:
        _refuse(name, what, f"holds numbers of {entry.dtype}", "float64 as the signals, without .half() or .float()")
    if what in ("force", "moment") and entry.shape[-1:] != (3,):
        _refuse(name, what, f"has the shape {tuple(entry.shape)}", f"{shape}, an entry for each axis last")
    try:
        np.broadcast_shapes(entry.shape, shape)
    except ValueError:
        _refuse(name, what, f"has the shape {tuple(entry.shape)}", f"{shape}")


def _points(model: Model) -> tuple[Tensor, Tensor]:
    """States [POINTS, nx] and controls [POINTS, nu] about the reference, drawn."""
    chance = torch.Generator().manual_seed(0)

    def drawn(names: tuple[str, ...]) -> Tensor:
        centre = torch.tensor([model.reference.get(n, 0.0) for n in names], dtype=torch.float64)
        return centre + 0.1 * torch.randn(POINTS, len(names), generator=chance, dtype=torch.float64)

    return drawn(model.layout.names), drawn(model.body.controls)


def _record(names: tuple[str, ...]) -> Tensor:
    """Waves [SAMPLES, n]."""
    time = torch.linspace(0.0, 4.0, SAMPLES, dtype=torch.float64)[:, None]
    return 0.1 * torch.sin(time * (1.0 + torch.arange(len(names)) / len(names)))
