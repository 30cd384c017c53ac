"""Forces and moments of the airframe beyond its derivatives: drag, damping, lift by speed, the wake on the tail."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from rotorid_torch.core.names import RATES, VELOCITIES
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.rigid import vec
from rotorid_torch.effects.base import Effect, Frame, Role, Showing, Stage, Values
from rotorid_torch.effects.reference import reference_of
from rotorid_torch.effects.registry import register
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.effects.testable import Needs, need, without_motors

DRAG_AREA = 0.01
"""Drag area of a fuselage over the rotor's disc; usual for helicopters."""
USUAL_DRAG = 2e-4
"""1/m: air density times drag area over twice the mass, where rotor and mass are not declared."""
MULTIROTOR_DRAG = 5e-3
"""1/m: the same of a multirotor, whatever its size: 0.01 along x and y, 0.02 along z for 0.5 kg (Hummingbird; Folk et
al., RotorPy, 2023); at 1.2 kg drag areas are some 0.02 m2 (Russell et al., NASA TM-2018-219758)."""
TAIL = 1.1
"""Distance of the tail behind the centre of gravity in rotor radii; usual, where none is declared."""
STILL = 1e-6
"""m2/s2 that keep a speed's derivative finite at rest."""


@register
class Drag(Effect):
    """Quadratic drag of the fuselage, along each body axis: -k V |V| with V the velocity through the air.

    What it is at the reference belongs to the trims and is taken away. k = air density x drag area/(2 mass).

    Source: Padfield, Helicopter Flight Dynamics, sec. 3.2.2 (fuselage); Hoerner, Fluid-Dynamic Drag.
    """

    id, stage, role, showing = "forces.drag", Stage.FORCES, Role.UNDECLARED, Showing.OTHER_FLIGHTS
    needs = (Needs.VELOCITIES, Needs.FORCES)
    separated_by = "flights trimmed at other speeds"
    reference: Tensor

    def __init__(self, base: float, reference: Tensor) -> None:
        rows = [(axis, share * base, f"drag along {axis}") for axis, share in (("x", 1.5), ("y", 5.0), ("z", 5.0))]
        bounds = 0.0, 100.0 * base
        super().__init__(tuple(Parameter(a, 0.0, "1/m", bounds, doc=doc, typical=size) for a, size, doc in rows))
        self.register_buffer("reference", reference)

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Drag:
        """Scaled by the declared rotor's disc and the mass."""
        base = MULTIROTOR_DRAG if spec.commands else USUAL_DRAG
        if spec.rotor is not None and spec.mass is not None:
            base = 0.5 * spec.air_density * DRAG_AREA * math.pi * spec.rotor.radius**2 / spec.mass
        return cls(base, reference_of(spec, VELOCITIES))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the drag beyond that of the reference."""

        def square(v: Tensor) -> Tensor:
            return v * torch.sqrt((v * v).sum(-1, keepdim=True) + STILL)

        beyond = square(frame.stack(VELOCITIES)) - square(self.reference)
        return frame.add(force=-p.stack("x", "y", "z") * beyond), x


@register
class QuadraticDamping(Effect):
    """Moments that oppose a body rate by its square: L -= k p |p|, M -= k q |q|, N -= k r |r|.

    Source: Tischler and Remple, Aircraft and Rotorcraft System Identification, ch. 15 (nonlinear damping terms).
    """

    id, stage, role = "forces.quadratic_damping", Stage.FORCES, Role.UNDECLARED
    needs = (Needs.RATES, without_motors("commands answer the rates: a term by rates takes up what is left of a lag"))

    def __init__(self) -> None:
        rows = [(row, f"damping by {rate} squared") for row, rate in zip("LMN", RATES, strict=True)]
        sizes = {"L": 2.0, "M": 1.0, "N": 1.0}
        super().__init__(tuple(Parameter(n, 0.0, "1/rad", (0.0, 30.0), doc=d, typical=sizes[n]) for n, d in rows))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the damping."""
        rates = frame.stack(RATES)
        return frame.add(moment=-p.stack("L", "M", "N") * rates * rates.abs()), x


@register
class TranslationalLift(Effect):
    """Translational lift: speed carries the rotor's wake away, the induced velocity falls, thrust rises.

    vi(V) = vh sqrt(sqrt(1 + s^2) - s), s = V^2/(2 vh^2), V in the disc, d = vi(V0) - vi(V); Z -= Z d, N += N d.

    Source: Glauert (1926); Padfield, Helicopter Flight Dynamics, eq. 3.118 ff.
    """

    id, stage, role = "forces.translational_lift", Stage.FORCES, Role.STRUCTURE
    needs = (
        Needs.VELOCITIES,
        Needs.FORCES,
        without_motors("propulsion.axial_inflow knows the lift of rotors by speed"),
    )
    separated_by = "flights trimmed at other speeds"
    showing = Showing.OTHER_FLIGHTS

    def __init__(self, speed: float) -> None:
        super().__init__(
            (
                Parameter("Z", 0.0, "1/s", (0.0, 3.0), doc="thrust by induced velocity", typical=0.4),
                Parameter("N", 0.0, "rad/(s m)", (-0.5, 0.5), doc="yaw by induced velocity", typical=0.01),
                Parameter("hover", 10.0, "m/s", (2.0, 20.0), 3.0, doc="induced velocity in hover", typical=10.0),
            )
        )
        self.square = speed * speed

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Effect:
        """About the reference's speed in the disc."""
        speed = math.hypot(spec.reference.get("u", 0.0), spec.reference.get("v", 0.0))
        return cls(speed)

    @classmethod
    def within(cls, spec: ModelSpec) -> str:
        """The nominal model's inflow, where it has one: momentum theory knows the speed."""
        return "inflow" if spec.inflow else ""

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds thrust and torque by the change of the induced velocity."""
        u, v, hover = frame.signals["u"], frame.signals["v"], p["hover"]

        def induced(square: Tensor | float) -> Tensor:
            s = 0.5 * square / (hover * hover)
            return hover * torch.sqrt(torch.sqrt(1.0 + s * s) - s)

        fallen = induced(self.square) - induced(u * u + v * v)
        zero = torch.zeros_like(p["Z"] * fallen)
        return frame.add(vec(zero, zero, -p["Z"] * fallen), vec(zero, zero, p["N"] * fallen)), x


@register
class TailInterference(Effect):
    """Main rotor's wake on the tail: it sweeps over tailplane and fin as the speed grows, and with sideslip.

    b = exp(-((u - speed)/width)^2 - (vt/width)^2), vt = v - arm r at the tail; M += M b, N += N b vt/width, without
    their values at the reference.

    Source: Padfield, Helicopter Flight Dynamics, sec. 3.2.2 (empennage in the rotor wake).
    """

    id, stage, role = "forces.tail_interference", Stage.FORCES, Role.UNDECLARED
    needs = (
        Needs.VELOCITIES,
        need(lambda spec: "ped" in spec.controls, "the vehicle has no pedal and so no tail rotor"),
    )
    separated_by = "flights trimmed at other speeds"
    showing = Showing.OTHER_FLIGHTS

    def __init__(self, arm: float, reference: Tensor) -> None:
        super().__init__(
            (
                Parameter("M", 0.0, "rad/s2", (-3.0, 3.0), doc="pitch in the middle of the wake", typical=0.1),
                Parameter("N", 0.0, "rad/s2", (-3.0, 3.0), doc="yaw in the middle of the wake", typical=0.1),
                Parameter("speed", 10.0, "m/s", (0.0, 40.0), 5.0, doc="at which the wake meets the tail", typical=10.0),
                Parameter("width", 6.0, "m/s", (2.0, 20.0), 3.0, doc="of the wake", typical=6.0),
            )
        )
        self.arm = arm
        self.at = reference.tolist()

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> TailInterference:
        """With the usual distance of the tail for the declared rotor."""
        arm = 0.0 if spec.rotor is None else TAIL * spec.rotor.radius
        return cls(arm, reference_of(spec, ("u", "v", "r")))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds pitch and yaw."""

        def met(u: Tensor | float, side: Tensor | float) -> tuple[Tensor, Tensor]:
            along, across = (u - p["speed"]) / p["width"], side / p["width"]
            bump = torch.exp(-along * along - across * across)
            return bump, bump * across

        now = met(frame.signals["u"], frame.signals["v"] - self.arm * frame.signals["r"])
        then = met(self.at[0], self.at[1] - self.arm * self.at[2])
        pitch, yaw = p["M"] * (now[0] - then[0]), p["N"] * (now[1] - then[1])
        return frame.add(moment=vec(torch.zeros_like(pitch), pitch, yaw)), x
