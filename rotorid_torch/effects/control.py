"""Effects of the control path: what lies between the recorded control and the swashplate.

Each acts on all controls alike through one parameter, and on each alone through one of its own that adds to it; those
are held at zero unless they are freed, or the spec has the effect act on each control by itself.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from rotorid_torch.core.names import is_control
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.effects.base import Effect, Role, Stage, Values
from rotorid_torch.effects.record import lagged, rate_limited, shifted, with_play_behind_noise
from rotorid_torch.effects.registry import register
from rotorid_torch.effects.spec import ModelSpec

LONGEST = 0.25
"""s: no control path is slower."""
EXCURSION = 0.02
"""rad: rms of a control about trim in flight tests, where the flights do not tell."""


def per_control(p: Values, common: str, names: tuple[str, ...]) -> Tensor:
    """The parameter of all controls plus each control's own [..., nu]; zero for other inputs, which are measured."""
    none = torch.zeros_like(p[common])
    shared = (p[common] if is_control(n) else none for n in names)
    return torch.stack([s + p[n] if n in p.names else s for s, n in zip(shared, names, strict=True)], dim=-1)


def excursion(spec: ModelSpec) -> float:
    """Mean of the controls' rms excursions, in the controls' unit."""
    return sum(spec.sizes.get(c, EXCURSION) for c in spec.controls) / len(spec.controls)


def _each(common: Parameter, controls: tuple[str, ...], alone: bool, least: float = 0.0) -> tuple[Parameter, ...]:
    """The parameter of all controls and each one's own: the former free, or where they act alone the latter."""
    bounds = 0.0 if alone else least, common.bounds[1]
    own = (replace(common, name=c, bounds=bounds, free=alone, doc=f"{common.doc}: {c}, added") for c in controls)
    return (replace(common, free=not alone), *own)


@register
class ControlDelay(Effect):
    """Pure delay of the controls: what is recorded reaches the rotor later.

    u_rotor(t) = u(t - delay), by cubic interpolation of the record; before its beginning the record is held.

    Source: Tischler and Remple, Aircraft and Rotorcraft System Identification, sec. 11.2 (equivalent time delay).
    """

    id, stage, role = "control.delay", Stage.CONTROL, Role.UNDECLARED

    def __init__(self, controls: tuple[str, ...] = (), alone: bool = False) -> None:
        common = Parameter("common", 0.0, "s", (0.0, LONGEST), doc="delay of every control", typical=0.06)
        # a control may be less late than the others, or in a model that lacks something lead
        super().__init__(_each(common, controls, alone, -LONGEST))

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> ControlDelay:
        """With the controls of the vehicle."""
        return cls(spec.controls, cls.id in spec.each_control)

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Controls [..., T, nu], each later by its delay."""
        return shifted(record, per_control(p, "common", names), dt)


@register
class ControlLag(Effect):
    """First-order lag of the controls: an actuator that is not in the model.

    tau du_rotor/dt = u - u_rotor, exact for controls linear between samples; tau = 0 is no lag.

    Source: Padfield, Helicopter Flight Dynamics, sec. 3.2.4 (actuation).
    """

    id, stage, role = "control.lag", Stage.CONTROL, Role.UNDECLARED

    def __init__(self, controls: tuple[str, ...] = (), alone: bool = False) -> None:
        common = Parameter("common", 0.0, "s", (0.0, 2 * LONGEST), doc="time constant of every control", typical=0.06)
        super().__init__(_each(common, controls, alone))

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> ControlLag:
        """With the controls of the vehicle."""
        return cls(spec.controls, cls.id in spec.each_control)

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Controls [..., T, nu], each behind its lag."""
        return lagged(record, per_control(p, "common", names), dt)


@register
class RateLimit(Effect):
    """Actuators that move no faster than a limit; the parameter is one over it, zero for no limit.

    |du_rotor/dt| <= 1/inverse, smoothly: at the limit the rate is cut to 0.92 of it.

    Source: Klyde and Mitchell (2004), J. Guidance 27, Investigating the role of rate limiting.
    """

    id, stage, role = "control.rate_limit", Stage.CONTROL, Role.UNDECLARED

    def __init__(
        self, controls: tuple[str, ...] = (), size: float = EXCURSION, unit: str = "rad", alone: bool = False
    ) -> None:
        per = {"rad": "s/rad", "m": "s/m"}.get(unit, "s")
        common = Parameter(
            "inverse",
            0.0,
            per,
            (0.0, 2.0 / size),
            doc="one over the greatest rate of every control",
            typical=0.1 / size,
            met=(0.025 / size,),
        )
        super().__init__(_each(common, controls, alone))

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> RateLimit:
        """With the controls of the vehicle; scaled by their excursions."""
        unit = spec.control_units.get(spec.controls[0], "rad")
        return cls(spec.controls, excursion(spec), unit, cls.id in spec.each_control)

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Controls [..., T, nu], each followed no faster than its limit."""
        return rate_limited(record, per_control(p, "inverse", names), dt)


@register
class Backlash(Effect):
    """Play in the control linkages: a control that turns round must first cross it.

    u_rotor stays within width/2 of u, and moves only when pushed; it starts in the middle. The noise of the
    record does not push it: it follows the record smoothed over 0.1 s.

    Source: Nordin and Gutman (2002), Automatica 38, Controlling mechanical systems with backlash.
    """

    id, stage, role = "control.backlash", Stage.CONTROL, Role.UNDECLARED

    def __init__(
        self, controls: tuple[str, ...] = (), size: float = EXCURSION, unit: str = "rad", alone: bool = False
    ) -> None:
        own = unit if unit in ("rad", "m") else "1"
        common = Parameter("width", 0.0, own, (0.0, 2.0 * size), doc="play of every control", typical=0.4 * size)
        super().__init__(_each(common, controls, alone))

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Backlash:
        """With the controls of the vehicle; scaled by their excursions."""
        unit = spec.control_units.get(spec.controls[0], "rad")
        return cls(spec.controls, excursion(spec), unit, cls.id in spec.each_control)

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Controls [..., T, nu], each through its play."""
        return with_play_behind_noise(record, per_control(p, "width", names), dt)
