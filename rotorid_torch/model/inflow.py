"""Uniform inflow of the main rotor by momentum theory: one state, the induced velocity, that follows the thrust."""

import math

import torch
from torch import Tensor

from rotorid_torch.core.names import INDUCED_SHARE
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.state import State
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values
from rotorid_torch.effects.families.main_rotor import KNOWN
from rotorid_torch.effects.momentum import induced_velocity
from rotorid_torch.effects.spec import RotorSpec

INDUCED = "vi"
CYCLIC = ("wa1", "wb1")
HARMONIC_MASS = 32.0 / (45.0 * math.pi)
APPARENT_MASS = 8.0 / (3.0 * math.pi)
TIME_BOUNDS = (0.02, 0.6)


def trim_velocity(
    rotor: RotorSpec, air_density: float, mass: float, reference: dict[str, float], thrust: float
) -> float:
    """Induced velocity at the reference, m/s, for a specific thrust, m/s2."""
    disc = mass / (2.0 * air_density * torch.pi * rotor.radius**2)
    u, v, w = (reference[n] for n in ("u", "v", "w"))
    at = (disc * thrust, u * u + v * v, -w)
    return float(induced_velocity(*(torch.tensor(a, dtype=torch.float64) for a in at)))


def _time_constant(mass: float, rotor: RotorSpec, reference: dict[str, float]) -> float:
    """Of an inflow state, s, by the apparent mass of the air it moves: mass R / V_m, V_m the flow through the disc."""
    trim = reference[INDUCED]
    flow = math.hypot(reference["u"], reference["v"], trim - reference["w"]) + trim
    return min(max(mass * rotor.radius / flow, 1.5 * TIME_BOUNDS[0]), TIME_BOUNDS[1] / 1.5)


class Inflow(Effect):
    """Induced velocity vi as a state, and the torque of induced power beyond its tangent.

    tau dvi/dt = vi(T, u, v, w) - vi, with the thrust T of the present force and vi(...) of momentum theory, of which an
    effect before may leave a share. The derivatives by vi in forces, moments and flapping are parameters of those
    equations. The rotor's torque adds s N (T - T0) [(vi - vi0) - (w - w0)]/Omega to the yawing moment, s = +1 for
    counter-clockwise seen from above.

    Source: Pitt and Peters, Vertica 5 (1981), uniform state; Padfield, Helicopter Flight Dynamics, sec. 3.2 (torque).
    """

    id, stage, role = "inflow", Stage.FORCES, Role.NOMINAL
    about_z: Tensor

    def __init__(
        self,
        rotor: RotorSpec,
        air_density: float,
        mass: float,
        inertia: Tensor,
        reference: dict[str, float],
        thrust: float,
    ) -> None:
        area = torch.pi * rotor.radius**2
        disc = mass / (2.0 * air_density * area)
        trim = reference[INDUCED]
        tau = _time_constant(APPARENT_MASS / 2.0, rotor, reference)
        super().__init__(
            (
                Parameter("tau", tau, "s", TIME_BOUNDS, tau, doc="time constant of the induced velocity"),
                Parameter("N", 1.0, "1", (-3.0, 5.0), 0.5, doc="share of induced power's torque beyond the tangent"),
            ),
            (State(INDUCED, "m/s", "induced velocity", spread=KNOWN * rotor.speed * rotor.radius),),
        )
        self.disc, self.trim, self.thrust, self.w = disc, trim, thrust, reference["w"]
        self.torque = rotor.spin * mass / rotor.speed
        self.register_buffer("about_z", torch.linalg.inv(inertia)[:, 2])

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the torque; the state's rate from the thrust of the frame's force."""
        assert frame.force is not None
        thrust, vi = -frame.force[..., 2], x[..., 0]
        u, v, w = (frame.signals[n] for n in ("u", "v", "w"))
        torque = self.torque * (thrust - self.thrust) * ((vi - self.trim) - (w - self.w))
        share = frame.signals.get(INDUCED_SHARE, 1.0)
        rate = (share * induced_velocity(self.disc * thrust, u * u + v * v, -w) - vi) / p["tau"]
        return frame.add(None, (p["N"] * torque).unsqueeze(-1) * self.about_z), rate.unsqueeze(-1)


class CyclicInflow(Effect):
    """First harmonics of the inflow, as the flapping they belong to: tau d(wa1, wb1)/dt = (a1, b1) - (wa1, wb1).

    A disc that tilts builds up inflow across itself, late; the flapping equations take these states as regressors. The
    time constant is held at the declared rotor's: the derivatives by these states and it tell the same story.

    Source: Pitt and Peters, Vertica 5 (1981), harmonic states, apparent mass 16/(45 pi).
    """

    id, stage, role = "cyclic_inflow", Stage.ROTOR, Role.NOMINAL

    def __init__(self, rotor: RotorSpec, reference: dict[str, float]) -> None:
        tau = _time_constant(2.0 * HARMONIC_MASS, rotor, reference)
        super().__init__(
            (Parameter("tau", tau, "s", TIME_BOUNDS, tau, free=False, doc="time constant of the first harmonics"),),
            tuple(State(n, "rad", "first harmonic of the inflow, as flapping", spread=KNOWN) for n in CYCLIC),
        )

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Rates of the two states; nothing is added to the frame."""
        return frame, (frame.stack(("a1", "b1")) - x) / p["tau"].unsqueeze(-1)
