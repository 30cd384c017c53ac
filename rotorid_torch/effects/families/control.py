"""Effects of the control path: what lies between the recorded control and the swashplate.

Each acts on all controls alike through one parameter, and on each alone through one of its own that adds to it; those
are held at zero unless they are freed, or the spec has the effect act on each control by itself.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import torch
from torch import Tensor

from rotorid_torch.core.names import is_control
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.effects.base import Effect, Role, Stage, Values
from rotorid_torch.effects.registry import register
from rotorid_torch.effects.signal_operations import lagged, rate_limited, shifted, with_play_behind_noise
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.effects.testable import without_motors

LONGEST = 0.25
"""s: no control path is slower."""
EXCURSION = 0.02
"""rad: rms of a control about trim in flight tests, where the flights do not tell."""
STILL = 0.1
"""Share of the mean excursion below which a control stands still."""
NONE: Mapping[str, float] = MappingProxyType({})
"""Sizes of no controls."""


def per_control(p: Values, common: str, names: tuple[str, ...]) -> Tensor:
    """The parameter of all controls plus each control's own [..., nu]; zero for other inputs, which are measured."""
    none = torch.zeros_like(p[common])
    shared = (p[common] if is_control(n) else none for n in names)
    return torch.stack([s + p[n] if n in p.names else s for s, n in zip(shared, names, strict=True)], dim=-1)


def places_in_play(p: Values, names: tuple[str, ...]) -> Tensor:
    """Where each control stands in its play when a flight begins [..., nu]; in the middle where it has none."""
    middle = torch.zeros_like(p["width"])
    return torch.stack([p[f"place.{n}"] if f"place.{n}" in p.names else middle for n in names], dim=-1)


def excursions(spec: ModelSpec) -> dict[str, float]:
    """The controls' rms excursions, in the controls' unit; of one that hardly moves as much as would tell."""
    sizes = {c: spec.sizes.get(c, EXCURSION) for c in spec.controls}
    return {c: max(size, STILL * _mean(sizes)) for c, size in sizes.items()}


def _mean(sizes: Mapping[str, float]) -> float:
    return sum(sizes.values()) / len(sizes) if sizes else EXCURSION


def _each(common: Parameter, single: Mapping[str, Parameter], alone: bool, least: float = 0.0) -> tuple[Parameter, ...]:
    """The parameter of all controls and each one's own: the former free, or where they act alone the latter.

    None has less of a range than all in common.
    """
    low, most = 0.0 if alone else least, common.bounds[1]
    added = (
        replace(p, name=c, bounds=(low, max(most, p.bounds[1])), free=alone, doc=f"{p.doc}: {c}, added")
        for c, p in single.items()
    )
    return (replace(common, free=not alone), *added)


class _Late(Effect):
    """By a time; of the vehicle's controls."""

    stage, role, delays = Stage.CONTROL, Role.UNDECLARED, "common"

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Effect:
        """With the controls of the vehicle."""
        return cls(spec.controls, cls.id in spec.each_control)  # pyright: ignore[reportArgumentType]


class _Sized(Effect):
    """By a size that goes with how far the vehicle's controls move."""

    stage, role, proportional = Stage.CONTROL, Role.UNDECLARED, False

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Effect:
        """With the controls of the vehicle; scaled by their excursions."""
        made_of = excursions(spec), spec.control_units.get(spec.controls[0], "rad"), cls.id in spec.each_control
        return cls(*made_of)  # pyright: ignore[reportArgumentType, reportCallIssue]


@register
class ControlDelay(_Late):
    """Pure delay of the controls: what is recorded reaches the rotor later.

    u_rotor(t) = u(t - delay), by cubic interpolation of the record; before its beginning the record is held.

    Source: Tischler and Remple, Aircraft and Rotorcraft System Identification, sec. 11.2 (equivalent time delay).
    """

    id = "control.delay"

    def __init__(self, controls: tuple[str, ...] = (), alone: bool = False) -> None:
        common = Parameter("common", 0.0, "s", (0.0, LONGEST), doc="delay of every control", typical=0.06)
        # a control may be less late than the others, or in a model that lacks something lead
        super().__init__(_each(common, dict.fromkeys(controls, common), alone, -LONGEST))

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Controls [..., T, nu], each later by its delay."""
        return shifted(record, per_control(p, "common", names), dt)


@register
class ControlLag(_Late):
    """First-order lag of the controls: an actuator that is not in the model.

    tau du_rotor/dt = u - u_rotor, exact for controls linear between samples; tau = 0 is no lag.

    Source: Padfield, Helicopter Flight Dynamics, sec. 3.2.4 (actuation).
    """

    id = "control.lag"
    needs = (without_motors("motor commands lag by propulsion.motor_lag"),)

    def __init__(self, controls: tuple[str, ...] = (), alone: bool = False) -> None:
        common = Parameter("common", 0.0, "s", (0.0, 2 * LONGEST), doc="time constant of every control", typical=0.06)
        super().__init__(_each(common, dict.fromkeys(controls, common), alone))

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Controls [..., T, nu], each behind its lag."""
        return lagged(record, per_control(p, "common", names), dt)


@register
class RateLimit(_Sized):
    """Actuators that move no faster than a limit; the parameter is one over it, zero for no limit.

    |du_rotor/dt| <= 1/inverse, smoothly: at the limit the rate is cut to 0.92 of it.

    Source: Klyde and Mitchell (2004), J. Guidance 27, Investigating the role of rate limiting.
    """

    id = "control.rate_limit"
    needs = (without_motors("motor commands pass no actuator with a limit"),)

    def __init__(self, sizes: Mapping[str, float] = NONE, unit: str = "rad", alone: bool = False) -> None:
        doc = "one over the greatest rate of every control"

        def at(size: float) -> Parameter:
            sized, bounds = 0.1 / size, (0.0, 2.0 / size)
            return Parameter("inverse", 0.0, f"s/{unit}", bounds, doc=doc, typical=sized, met=(0.25 * sized,))

        super().__init__(_each(at(_mean(sizes)), {c: at(size) for c, size in sizes.items()}, alone))

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Controls [..., T, nu], each followed no faster than its limit."""
        return rate_limited(record, per_control(p, "inverse", names), dt)


@register
class Backlash(_Sized):
    """Play in the control linkages: a control that turns round must first cross it.

    u_rotor stays within width/2 of u, and moves only when pushed. Where in the play each control stands when a flight
    begins, -1 to 1 of half the width, is a parameter of its own, one for all flights: they begin at the same trim. The
    noise of the record does not push the linkage: it follows the record smoothed over 0.1 s.

    Source: Nordin and Gutman (2002), Automatica 38, Controlling mechanical systems with backlash.
    """

    id = "control.backlash"
    needs = (without_motors("motor commands pass no linkage"),)

    def __init__(self, sizes: Mapping[str, float] = NONE, unit: str = "rad", alone: bool = False) -> None:
        unit_of_play = unit if unit in ("rad", "m") else "1"

        def at(size: float) -> Parameter:
            sized, bounds, doc = 0.4 * size, (0.0, 2.0 * size), "play of every control"
            return Parameter("width", 0.0, unit_of_play, bounds, doc=doc, typical=sized, met=(3.0 * sized,))

        places = (
            Parameter(f"place.{c}", 0.0, "1", (-1.0, 1.0), doc=f"where in its play {c} stands at first", nuisance=True)
            for c in sizes
        )
        super().__init__((*_each(at(_mean(sizes)), {c: at(size) for c, size in sizes.items()}, alone), *places))

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Controls [..., T, nu], each through its play."""
        return with_play_behind_noise(record, per_control(p, "width", names), dt, places_in_play(p, names))
