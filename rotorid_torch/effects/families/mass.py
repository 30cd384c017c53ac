"""Mass, centre of gravity and inertia other than declared, and a load on a cable."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from rotorid_torch.core.parameters import Parameter, alike
from rotorid_torch.core.rigid import cross, vec
from rotorid_torch.core.state import State
from rotorid_torch.effects.base import Effect, Frame, Role, Showing, Stage, Values
from rotorid_torch.effects.reference import trim_force
from rotorid_torch.effects.registry import register
from rotorid_torch.effects.spec import ModelSpec, arm
from rotorid_torch.effects.testable import Needs

PRODUCTS = {"Ixx": ((0, 0),), "Iyy": ((1, 1),), "Izz": ((2, 2),), "Ixz": ((0, 2), (2, 0))}


def inertia_of(spec: ModelSpec) -> Tensor:
    """Declared inertia [3, 3]."""
    assert spec.inertia is not None
    return torch.tensor(spec.inertia, dtype=torch.float64)


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Scalar product of vectors [..., 3]."""
    return (a * b).sum(-1)


def times(matrix: Tensor, vector: Tensor) -> Tensor:
    """Matrices [..., 3, 3] times vectors [..., 3]."""
    return (matrix * vector.unsqueeze(-2)).sum(-1)


CABLES = (3.0, 6.0, 12.0, 24.0)
"""m: pendulums of these lengths are far enough apart to be missed from each other, and near enough to be reached."""
LOWEST = 0.01
"""Square of the vertical part of a cable's direction, at least."""
SWAY = 0.02
"""rad, rad/s: a free swing of the load at the start of every segment would imitate any slow drift."""


@register
class Payload(Effect):
    """Mass other than declared: forces beyond trim move a heavier vehicle less.

    f = f_trim + (f - f_trim)/(1 + extra/mass), specific forces; at trim the weight is carried whatever it is.

    Source: Etkin and Reid, Dynamics of Flight (3rd ed.), sec. 4.6 (mass in the equations of motion).
    """

    id, stage, role, showing = "mass.payload", Stage.MASS, Role.UNDECLARED, Showing.ABSORBED
    rotors_absorb = "rotors.thrust"
    needs = (Needs.MASS, Needs.NOTHING_ASIDE, Needs.FORCES)
    separated_by = "flights before and after a known load is moved"
    trim: Tensor

    def __init__(self, mass: float, trim: Tensor) -> None:
        bounds = (-0.3 * mass, 0.6 * mass)
        super().__init__((Parameter("extra", 0.0, "kg", bounds, doc="mass beyond the declared", typical=0.1 * mass),))
        self.mass = mass
        self.register_buffer("trim", trim)

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Payload:
        """From the declared mass."""
        assert spec.mass is not None
        return cls(spec.mass, trim_force(spec))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Takes from the force beyond trim what the extra mass swallows."""
        assert frame.force is not None
        share = p["extra"] / (self.mass + p["extra"])
        return frame.add(force=-share.unsqueeze(-1) * (frame.force - self.trim)), x


@register
class CentreOfGravity(Effect):
    """Centre of gravity elsewhere than declared: forces get another lever, the IMU another place.

    moment -= inertia^-1 (mass c x (f - f_trim)), c from the declared to the true centre of gravity; the constant part
    belongs to the trims. The accelerometers' arm becomes imu - c.

    Source: Etkin and Reid, Dynamics of Flight (3rd ed.), sec. 4.2; Jategaonkar, eq. 10.9 ff.
    """

    id, stage, role, showing = "mass.cg", Stage.MASS, Role.UNDECLARED, Showing.ABSORBED
    rotors_absorb = "rotors.trim"
    needs = (Needs.INERTIA, Needs.NOTHING_ASIDE, Needs.FORCES)
    separated_by = "flights before and after a known load is moved"
    inverse: Tensor
    trim: Tensor

    def __init__(self, mass: float, inertia: Tensor, trim: Tensor) -> None:
        gyration = math.sqrt(0.5 * float(inertia.diagonal().sum()) / mass)
        shares, bounds = {"x": 0.04, "y": 0.01, "z": 0.04}, (-0.25 * gyration, 0.25 * gyration)
        rows = ((axis, share * gyration) for axis, share in shares.items())
        super().__init__(tuple(Parameter(a, 0.0, "m", bounds, doc=f"along {a}", typical=t) for a, t in rows))
        self.register_buffer("inverse", mass * torch.linalg.inv(inertia))
        self.register_buffer("trim", trim)

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> CentreOfGravity:
        """From the declared mass and inertia."""
        assert spec.mass is not None
        return cls(spec.mass, inertia_of(spec), trim_force(spec))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the moment of the other lever; says where the centre of gravity is."""
        assert frame.force is not None
        centre = p.stack("x", "y", "z")
        moment = -times(self.inverse, cross(centre, frame.force - self.trim))
        return replace(frame, centre=centre).add(moment=moment), x


@register
class Inertia(Effect):
    """Inertia other than declared: moments turn the body otherwise, and gyroscopic moments change.

    I' = I with relative errors of Ixx, Iyy, Izz, Ixz; moment' = I'^-1 I moment, gyroscopic part by I'.

    Source: Etkin and Reid, Dynamics of Flight (3rd ed.), eq. 4.5,9 (Euler's equations).
    """

    id, stage, role, showing = "mass.inertia", Stage.MASS, Role.UNDECLARED, Showing.ABSORBED
    rotors_absorb = "rotors.power"
    needs = (Needs.INERTIA, Needs.NOTHING_ASIDE)
    separated_by = "flights before and after a known load is moved"
    inertia: Tensor
    entries: Tensor

    def __init__(self, inertia: Tensor) -> None:
        super().__init__(alike(PRODUCTS, "1", (-0.4, 1.0), "relative error of {}", typical=0.15))
        entries = torch.zeros(len(PRODUCTS), 3, 3, dtype=torch.float64)
        for k, places in enumerate(PRODUCTS.values()):
            for i, j in places:
                entries[k, i, j] = inertia[i, j]
        self.register_buffer("inertia", inertia)
        self.register_buffer("entries", entries)

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Inertia:
        """From the declared inertia."""
        return cls(inertia_of(spec))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds what the other inertia does to moments and gyroscopic moments; the model adds those of the declared."""
        assert frame.moment is not None
        rates = frame.stack(("p", "q", "r"))
        more = (p.vector[..., None, None] * self.entries).sum(-3)
        inverse = torch.linalg.inv(self.inertia + more)
        declared = times(torch.linalg.inv(self.inertia), cross(rates, times(self.inertia, rates)))
        moment = times(more, frame.moment - declared) + cross(rates, times(more, rates))
        return frame.add(moment=-times(inverse, moment)), x


@register
class SlungLoad(Effect):
    """Load on a cable: a pendulum below the hook that pulls the vehicle about.

    (x, y) are the horizontal parts of the cable's direction c = (x, y, sqrt(1 - x^2 - y^2)) in level axes that turn
    with the heading. The load falls freely but for the tension: c'' = d - (c d + c'^2) c, d = -f/l - 2 damping
    sqrt(g/l) c', with f the specific force that the hook feels, or the centre of gravity where no inertia is declared.
    The load pulls the hook by ratio (l c'^2 - c f) along c, per mass of the vehicle; ratio is load over declared mass.
    What the pull is at trim belongs to the trims; centripetal parts of the hook's acceleration are left out. Vehicles
    with a radius of gyration below 1 m have hooks and cables that are shorter in proportion; those of multirotors go
    with the arms.

    Source: Cicolani and Kanning, NASA TP-3280 (1992); Fusato, Guglieri and Celi (2001), J. American Helicopter Society
    46.
    """

    id, stage, role = "mass.slung_load", Stage.MASS, Role.UNDECLARED
    needs = (Needs.VELOCITIES, Needs.FORCES)
    hang: Tensor
    inverse: Tensor | None

    def __init__(self, gravity: float, trim: Tensor, inverse: Tensor | None, size: float) -> None:
        depth, below = (0.0, 4.0 * size), "of the hook below the centre of gravity"
        hook = Parameter("hook", size, "m", depth, 0.5 * size, doc=below, typical=size)
        long, cables = 8.0 * size, tuple(size * cable for cable in CABLES)
        lengths, spread = (size, 60.0 * size), 5.0 * size
        super().__init__(
            (
                Parameter("ratio", 0.0, "1", (0.0, 0.8), doc="mass of the load over the vehicle's", typical=0.12),
                Parameter("length", long, "m", lengths, spread, doc="of the cable", typical=long, tried=cables),
                Parameter("damping", 0.08, "1", (0.0, 0.7), 0.08, doc="of the pendulum, of critical", typical=0.08),
                *(() if inverse is None else (hook,)),
            ),
            (
                State("x", "1", "part of the cable's direction that is forward", spread=SWAY),
                State("y", "1", "part of the cable's direction to the right", spread=SWAY),
                State("x_rate", "1/s", "rate of x", spread=SWAY),
                State("y_rate", "1/s", "rate of y", spread=SWAY),
            ),
        )
        self.gravity = gravity
        self.register_buffer("hang", -trim)
        self.register_buffer("inverse", inverse)

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> SlungLoad:
        """The hook's moment where mass and inertia are declared; cables in proportion to the vehicle."""
        inverse, size = None, 1.0
        if spec.mass is not None and spec.inertia is not None:
            inverse = spec.mass * torch.linalg.inv(inertia_of(spec))
            size = min(1.0, float((3.0 / inverse.trace()).sqrt()))
        return cls(spec.gravity, trim_force(spec), inverse, arm(spec) if spec.motors else size)

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the tension at the hook; the pendulum's rates."""
        assert frame.force is not None
        signals = frame.signals
        phi, theta = signals["phi"], signals["theta"]
        sp, cp, st, ct = torch.sin(phi), torch.cos(phi), torch.sin(theta), torch.cos(theta)
        turn = (signals["q"] * sp + signals["r"] * cp) / ct
        cx, cy, cx_rate, cy_rate = x.unbind(-1)
        cz = torch.sqrt((1.0 - cx * cx - cy * cy).clamp(min=LOWEST))
        rx, ry = cx_rate - turn * cy, cy_rate + turn * cx
        rate = vec(rx, ry, -(cx * rx + cy * ry) / cz)
        cable = vec(cx * ct - cz * st, cx * sp * st + cy * cp + cz * sp * ct, cx * cp * st - cy * sp + cz * cp * ct)
        whirl, ratio = dot(rate, rate), p["ratio"]
        other = frame.force - ratio.unsqueeze(-1) * self.hang  # what the vehicle feels beside the pull
        tension = ratio * (p["length"] * whirl - dot(cable, other)) / (1.0 + ratio)
        force = tension.unsqueeze(-1) * cable - ratio.unsqueeze(-1) * self.hang
        moment, hook = None, None
        if self.inverse is not None:
            zero = torch.zeros_like(p["hook"])
            hook = vec(zero, zero, p["hook"])
            moment = times(self.inverse, cross(hook, force))
        frame = frame.add(force, moment)
        assert frame.force is not None
        turned = 0.0 if hook is None or frame.moment is None else cross(frame.moment, hook)
        fx, fy, fz = (frame.force + turned).unbind(-1)
        down = fy * sp + fz * cp
        felt = vec(fx * ct + down * st, fy * cp - fz * sp, down * ct - fx * st)
        calm = 2.0 * p["damping"] * torch.sqrt(self.gravity / p["length"])
        driven = -felt / p["length"].unsqueeze(-1) - calm.unsqueeze(-1) * rate
        along = dot(vec(cx, cy, cz), driven) + whirl
        cx_turn = driven[..., 0] - along * cx + turn * (2.0 * cy_rate + turn * cx)
        cy_turn = driven[..., 1] - along * cy + turn * (turn * cy - 2.0 * cx_rate)
        rates = cx_rate, cy_rate, cx_turn, cy_turn
        return frame, vec(*rates)
