"""The way of controls and of outputs, element by element, as an exported model walks it sample by sample.

Inside the package these effects act on whole records (`Effect.tape`); here each is one of a few elements with a memory,
which `runtime/model.c` spells out. What an element needs, its size by channel, is traced from torch.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from rotorid_torch.core.names import is_motor
from rotorid_torch.core.native.graph.emit import SHARED
from rotorid_torch.core.native.graph.symbols import Graph
from rotorid_torch.core.native.graph.tracing import scalarise
from rotorid_torch.effects.base import Effect, Stage, Values
from rotorid_torch.effects.families.control import per_control, places_in_play
from rotorid_torch.effects.families.sensors import PERIOD, SMOOTHED, per_channel
from rotorid_torch.errors import InputError, Unsupported, say_once
from rotorid_torch.model.model import Model

DT = 0.01
"""s: sample interval at which it is tried whether an effect has a memory."""
SAMPLES = 8
"""Samples of that record, per signal."""
AGREE = 1e-12
"""Difference at which an effect without memory gives the same on a record as on its samples one by one."""
Sizes = Callable[[Values, tuple[str, ...]], Tensor]


@dataclass(frozen=True)
class Element:
    """One element: its kind in the C code, and the nodes of its size, and of the place in a play, by channel.

    results : of an element without memory, the nodes of what comes out, by channel.
    """

    kind: str
    sizes: tuple[int, ...] = ()
    places: tuple[int, ...] = ()
    results: tuple[int, ...] = ()


def _common(parameter: str) -> Sizes:
    """A parameter that all controls have in common, or each for itself."""
    return lambda p, names: per_control(p, parameter, names)


def _motor_lag(p: Values, names: tuple[str, ...]) -> Tensor:
    return torch.stack([p["tau"] if is_motor(n) else torch.zeros_like(p["tau"]) for n in names], dim=-1)


CONTROLS: Mapping[str, tuple[str, Sizes]] = {
    "control.delay": ("DELAY", _common("common")),
    "control.lag": ("LAG", _common("common")),
    "propulsion.motor_lag": ("LAG", _motor_lag),
    "control.rate_limit": ("RATE_LIMIT", _common("inverse")),
    "control.backlash": ("PLAY", _common("width")),
}
OUTPUTS: Mapping[str, tuple[str, Sizes]] = {
    "sensors.delay": ("DELAY", per_channel),
    "sensors.filter": ("LAG", per_channel),
}
"""Effects that have a memory, by id: the element, and its size by channel."""


def control_path(model: Model, graph: Graph) -> list[Element]:
    """Elements between the recorded controls and the rotor, in order.

    Raises InputError: an effect looks ahead in the record, or knows whole records alone.
    """
    for k, effect in enumerate(model.chain):
        p = model.values(model.theta.detach(), k)
        if effect.id == "sensors.delay" and float(p["controls"]) != 0.0:
            wrong = f"is {float(p['controls']):g} s: the model looks ahead in the controls' record"
            raise InputError("export", f"{effect.id}.controls", wrong, "0, for a model that runs in time")
    return _elements(model, graph, Stage.CONTROL, model.body.controls, CONTROLS)


def output_path(model: Model, graph: Graph) -> list[Element]:
    """Elements between the ideal sensors and the recorded outputs, in order; InputError as for `control_path`."""
    for k, effect in enumerate(model.chain):
        p = model.values(model.theta.detach(), k)
        for name in p.names:
            if effect.id == "sensors.filter" and name.endswith((PERIOD, SMOOTHED)) and float(p[name]) != 0.0:
                wrong = f"is {float(p[name]):g}: an exported model has filters of first order alone"
                raise InputError("export", f"{effect.id}.{name}", wrong, "0, or the model without its sensors' filters")
    return _elements(model, graph, Stage.SENSORS, model.body.outputs, OUTPUTS)


def times(model: Model, kind: str) -> tuple[Tensor, Tensor]:
    """Sums of the sizes of a kind's elements, "DELAY" or "LAG", s: by control [nu] and by output [ny]."""
    sums = []
    for library, names in ((CONTROLS, model.body.controls), (OUTPUTS, model.body.outputs)):
        total = torch.zeros(len(names), dtype=torch.float64)
        for k, effect in enumerate(model.chain):
            if effect.id in library and library[effect.id][0] == kind:
                total = total + library[effect.id][1](model.values(model.theta.detach(), k), names)
        sums.append(total)
    return sums[0], sums[1]


def _elements(
    model: Model, graph: Graph, stage: Stage, names: tuple[str, ...], library: Mapping[str, tuple[str, Sizes]]
) -> list[Element]:
    elements = []
    for k, effect in enumerate(model.chain):
        if effect.stage is not stage or type(effect).tape is Effect.tape:
            continue
        if effect.id in library:
            elements.append(_with_memory(model, graph, k, names, library[effect.id]))
        else:
            elements.append(_without_memory(model, graph, k, names))
    return elements


def _with_memory(model: Model, graph: Graph, k: int, names: tuple[str, ...], element: tuple[str, Sizes]) -> Element:
    kind, sizes = element
    theta = model.theta.detach()
    effect = model.chain[k]
    at = sizes(model.values(theta, k), names)
    if bool((at < 0.0).any()):
        early = names[int(at.argmin())]
        wrong = f"{early} comes {-float(at.min()):g} s before it is recorded"
        raise InputError("export", effect.id, wrong, "none that is early, for a model that runs in time")
    nodes = scalarise(graph, lambda th: sizes(model.values(th, k), names), {SHARED: theta})
    if kind != "PLAY":
        return Element(kind, tuple(nodes))
    places = scalarise(graph, lambda th: places_in_play(model.values(th, k), names), {SHARED: theta})
    return Element(kind, tuple(nodes), tuple(places))


def _without_memory(model: Model, graph: Graph, k: int, names: tuple[str, ...]) -> Element:
    """An effect that gives the same on single samples as on a record, where what it averages is steady; or refused."""
    theta, effect = model.theta.detach(), model.chain[k]

    def one(u: Tensor, th: Tensor) -> Tensor:
        return effect.tape(u[None], names, DT, model.values(th, k))[0]

    at = torch.tensor([model.reference.get(n, 0.0) for n in names], dtype=torch.float64)
    record = at + 0.1 * (at.abs() + 0.1) * torch.sin(torch.arange(SAMPLES * len(names)).double()).view(SAMPLES, -1)
    for name in [n for n in effect.averages if n in names]:
        record[:, names.index(name)] = at[names.index(name)]
        mean = f"means over {effect.averages[name]:g} s, and the share of faster changes that acts in model.pt"
        say_once(f"{effect.id}: an exported model takes {name} as it comes; feed {mean}")
    whole = effect.tape(record, names, DT, model.values(theta, k))
    if not torch.allclose(whole, torch.stack([one(u, theta) for u in record]), rtol=AGREE, atol=AGREE):
        wrong = "acts on whole records, and an exported model has samples one by one"
        wish = f"effects with rates of their own, or {', '.join((*CONTROLS, *OUTPUTS))}"
        raise InputError("export", effect.id, wrong, wish)
    try:
        return Element("INSTANT", results=tuple(scalarise(graph, one, {"u": at, SHARED: theta})))
    except Unsupported as error:
        wrong = f"cannot be written in C: {error}"
        raise InputError("export", effect.id, wrong, "torch operations on numbers") from None
