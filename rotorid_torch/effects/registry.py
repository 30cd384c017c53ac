"""The effects that exist, by id: the library's own and those that other packages offer under an entry point."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, TypeVar

import torch

from rotorid_torch.arguments import listed
from rotorid_torch.effects.base import Effect
from rotorid_torch.errors import InputError, nearest

if TYPE_CHECKING:
    from rotorid_torch.effects.spec import ModelSpec

LIBRARY = ("control", "main_rotor", "rotor_speed", "airframe", "environment", "mass", "sensors", "propulsion", "neural")
"""Files of `families/`, which register their effects when they are imported; a new file is named here."""
LIBRARY_PACKAGE = "rotorid_torch"
ENTRY_POINTS = "rotorid_torch.effects"
EFFECTS: dict[str, type[Effect]] = {}

E = TypeVar("E", bound=type[Effect])


def register(effect: E) -> E:
    """Class decorator: the effect can be named by its id; its `from_spec` makes it for a vehicle.

    Raises
    ------
    InputError : no class of an effect, without an id, or with an id that another class has.
    """
    if not (isinstance(effect, type) and issubclass(effect, Effect)):
        raise InputError("register", "effect", f"{effect!r} is no class of an effect", "a subclass of rotorid.Effect")
    if not isinstance(effect.id, str) or not effect.id:
        raise InputError("register", effect.__name__, f"has no id, but {effect.id!r}", "id = 'my.drag' in the class")
    if effect.__module__.partition(".")[0] != LIBRARY_PACKAGE:
        _import_library()  # its ids are taken
    other = EFFECTS.get(effect.id, effect)
    if (other.__module__, other.__qualname__) != (effect.__module__, effect.__qualname__):
        taken = f"the id {effect.id!r} is taken by {other.__module__}.{other.__qualname__}"
        raise InputError("register", effect.__name__, taken, "an id that no other effect has, as 'my.drag'")
    EFFECTS[effect.id] = effect
    return effect


def registered() -> dict[str, type[Effect]]:
    """All effects by id, those of other packages included.

    Raises InputError: a module of another package cannot be imported, or registers an id that is taken.
    """
    _import()
    return EFFECTS


@cache
def _import() -> None:
    """Modules register their effects when they are imported; which there are does not change while a process runs."""
    _import_library()
    for point in entry_points(group=ENTRY_POINTS):
        try:
            point.load()
        except Exception as error:  # others' code may fail in any way
            wrong = f"cannot be loaded ({type(error).__name__}: {error})"
            raise InputError(
                f"effects of {point.name}", point.value, wrong, "a module that registers effects"
            ) from error


def _import_library() -> None:
    for name in LIBRARY:
        import_module(f"rotorid_torch.effects.families.{name}")


def of_others() -> list[str]:
    """Ids of the effects that are not the library's."""
    return [name for name, effect in registered().items() if effect.__module__.split(".")[0] != LIBRARY_PACKAGE]


def of_scripts() -> list[str]:
    """Ids of the effects that no installed package brings, so that other processes do not know these."""
    packages = {point.module.split(".")[0] for point in entry_points(group=ENTRY_POINTS)}
    return [name for name in of_others() if registered()[name].__module__.split(".")[0] not in packages]


def predicted_by(names: Iterable[str]) -> tuple[str, ...]:
    """Channels beyond the body's that these effects predict."""
    effects_by_id = registered()
    return tuple(dict.fromkeys(c for name in names if name in effects_by_id for c in effects_by_id[name].predicts))


def obstacle(name: str, spec: ModelSpec) -> str | None:
    """Why an effect that exists cannot join a vehicle's model: it is there already, or cannot be tested; else None."""
    effect = registered()[name]
    part = effect.within(spec)
    return f"the nominal model has it already, as its part '{part}'" if part else effect.untestable(spec)


def make(name: str, spec: ModelSpec) -> Effect:
    """The effect of this id for a vehicle; InputError where there is none, or the vehicle's data cannot test it."""
    effects_by_id = registered()
    if name not in effects_by_id:
        wrong = f"there is no such effect{nearest(name, effects_by_id)}"
        others = f"an effect of your own whose module is imported, or one of {listed(sorted(effects_by_id))}"
        raise InputError("--effect", name, wrong, others)
    reason = obstacle(name, spec)
    if reason is not None:
        raise InputError("--effect", name, f"this data set cannot test it: {reason}", "another effect, or other data")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)  # weights of networks are drawn alike whenever the effect is made
        return effects_by_id[name].from_spec(spec)
