"""Rotors of a multirotor: thrust and torque of each from its speed or command, at its place on the body."""

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from rotorid_torch.core.names import FORCES, MOMENTS, thrust_share
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.rigid import cross, vec
from rotorid_torch.core.state import State
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values
from rotorid_torch.effects.spec import USUAL_GYRATION, ModelSpec

TORQUE_ARM = 0.1
"""Torque over thrust of a rotor as a share of its arm, where it is not declared: usual for small propellers."""
MOST = 10.0
"""Control power beyond this share of what is declared is an error of the declaration, not of the estimate."""
BELIEVED = (1.0 / 3.0, 3.0)
"""Control power over the declared within which another inertia can be the reason."""
UNITS = {
    (True, False): ("N", "N", "N"),
    (True, True): ("N", "N s/rad", "N s2/rad2"),
    (False, False): ("m/s2", "m/s2", "m/s2"),
    (False, True): ("m/s2", "m/(s rad)", "m/rad2"),
}
"""Of the thrust curve, by whether the mass is declared and whether the rotors' speeds are measured."""
DISTURBED = 0.05
"""Standard deviation of a disturbance over the rms of the angular acceleration of its axis."""
NO_POWER = 1e-12
"""Control power that is nothing, in any of its units."""
LEAST_THRUST = 0.1
"""Of a rotor's usual thrust: forces that grow with thrust are over no less than that."""
LEAST_COMMAND = 1e-3
"""Below it the root of a command is held, for its slope would be infinite."""


def hover_thrust(spec: ModelSpec) -> float:
    """Thrust of one rotor at the reference, N, or m/s2 (per mass) where no mass is declared."""
    phi, theta = spec.reference.get("phi", 0.0), spec.reference.get("theta", 0.0)
    return (spec.mass or 1.0) * spec.gravity * math.cos(phi) * math.cos(theta) / len(spec.motors)


def hover_input(spec: ModelSpec) -> float:
    """Mean input of the rotors at the reference: command, or speed in rad/s."""
    return sum(spec.reference[name] for name in spec.driven) / len(spec.driven) or 1.0


def power_declared(spec: ModelSpec, moment: str) -> float | None:
    """Control power of a moment that the declaration says; None where it says none.

    1 where places, mass and inertia are declared (and of yaw the ratios of torque). Where places are not, mass and
    inertia tell how far from a level axis rotors usually stand: sqrt(I/m)/0.7.
    """
    if spec.mass is None or spec.inertia is None:
        return None
    if moment == "N":
        return 1.0 if powers_declared(spec) and all(m.torque_ratio is not None for m in spec.motors) else None
    if powers_declared(spec):
        return 1.0
    axis = MOMENTS.index(moment)
    inertia, places = spec.inertia[axis][axis], [m.position[1 - axis] for m in spec.motors]
    spacing = math.hypot(*places) / math.sqrt(len(places))
    return math.sqrt(inertia / spec.mass) / USUAL_GYRATION / (spacing * inertia) if spacing else None


def believable(spec: ModelSpec, moment: str, power: float) -> bool:
    """Whether another inertia can be the reason of a moment's control power, over the declared one if there is one."""
    declared = power_declared(spec, moment)
    return declared is None or BELIEVED[0] < power / declared < BELIEVED[1]


def beyond_belief(spec: ModelSpec, values: Mapping[str, float]) -> tuple[str, ...]:
    """Moments whose control power among these values is so far from the declared that no inertia is the reason."""
    return tuple(row for row in MOMENTS if not believable(spec, row, values[f"rotors.power.{row}"]))


class Rotors(Effect):
    """Each rotor's thrust T = c0 + c1 s + c2 s^2 along -z and torque about its axis, s its command or measured speed.

    Z = -sum T/m; L and M by the declared places over the declared inertia, N by spin and torque ratio, each times a
    control power that is 1 if the declaration holds. No damping: rotors' other physics are effects of their own, and
    forces that these bring to the hubs act there, those of leaning discs as large as thrust is. Forces across the arms
    turn yaw by the inertia that roll and pitch tell, of a flat body the sum of theirs: the control power of yaw holds
    the ratio of torque to thrust as well.
    Where mass and inertia are not declared, thrust is per mass and control power carries the inertia.

    Source: Mahony, Kumar and Corke, IEEE Robotics and Automation Magazine 19 (2012), eqs. 5 to 7; Foerster, System
    Identification of the Crazyflie 2.0 (ETH, 2015), sec. 3.
    """

    id, stage, role = "rotors", Stage.FORCES, Role.NOMINAL
    place: Tensor
    torque: Tensor
    turning: Tensor

    def __init__(self, spec: ModelSpec, prior_span: float) -> None:
        super().__init__((*_curve(spec), *_powers(spec), *_trims(spec, prior_span)))
        self.driven, self.mass, self.at = spec.driven, spec.mass or 1.0, hover_input(spec)
        self.least = LEAST_THRUST * hover_thrust(spec)
        self.forces = tuple(row for row in FORCES[:2] if row in spec.patterns)
        inertia, self.flat = torch.eye(3, dtype=torch.float64), 1.0
        if powers_declared(spec):
            inertia, self.flat = torch.tensor(spec.inertia, dtype=torch.float64), 2.0
        arm = sum(math.hypot(*m.position[:2]) for m in spec.motors) / len(spec.motors)
        ratios = [TORQUE_ARM * arm if m.torque_ratio is None else m.torque_ratio for m in spec.motors]
        self.register_buffer("place", torch.tensor([m.position for m in spec.motors], dtype=torch.float64))
        torques = [m.spin * r for m, r in zip(spec.motors, ratios, strict=True)]
        self.register_buffer("torque", torch.tensor(torques, dtype=torch.float64))
        self.register_buffer("turning", torch.linalg.inv(inertia))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds thrust, moments and trims."""
        s = frame.stack(self.driven)
        c0, c1, c2 = p.stack("thrust.c0", "thrust.c1", "thrust.c2").unsqueeze(-2).unbind(-1)
        thrust = c0 + s * (c1 + s * c2)  # [..., motors]
        usual = (c0 + self.at * (c1 + self.at * c2)).clamp(min=self.least)
        if frame.flow is not None:
            thrust = usual * frame.flow.share(thrust / usual)
        shares = tuple(thrust_share(name) for name in self.driven)
        zero = torch.zeros_like(thrust)
        forces = vec(zero, zero, -thrust)
        if frame.hubs is not None:
            forces = forces + frame.hubs
        if frame.leaning is not None:
            forces = forces - frame.leaning * forces[..., 2:] / usual.unsqueeze(-1)
        if set(shares) <= set(frame.signals):  # a damaged rotor gives less of every force
            share = frame.stack(shares)
            thrust, forces = thrust * share, forces * share.unsqueeze(-1)
        roll, pitch, yaw = cross(self.place, forces).sum(-2).unbind(-1)
        L, M, N = p.stack("power.L", "power.M", "power.N").unbind(-1)
        flat = self.flat * L * M / (L + M + NO_POWER)
        angular = vec(L * roll, M * pitch, flat * yaw + N * (self.torque * thrust).sum(-1)) @ self.turning.mT
        trims = [p[f"trim.{row}"] if row in self.forces else zero[..., 0] for row in FORCES[:2]]
        force = forces.sum(-2) / self.mass + vec(*trims, zero[..., 0])
        return frame.add(force, angular + p.stack(*(f"trim.{row}" for row in MOMENTS))), x


def _curve(spec: ModelSpec) -> tuple[Parameter, ...]:
    """Thrust curve: as declared, or the square that carries the weight at the reference; held if it does not show."""
    units = UNITS[spec.mass is not None, spec.driven[0].startswith("omega")]
    lift, at = hover_thrust(spec), hover_input(spec)
    curves = [m.thrust for m in spec.motors if m.thrust is not None]
    mean = [sum(c[k] for c in curves) / len(curves) for k in range(3)] if curves else [0.0, 0.0, lift / at**2]
    docs = ("thrust at rest", "thrust by the rotor's input", "thrust by its square")
    shown = "Z" in spec.patterns
    return tuple(
        Parameter(f"thrust.c{k}", mean[k], units[k], prior_sd=lift / at**k, free=shown, doc=docs[k]) for k in range(3)
    )


def _powers(spec: ModelSpec) -> tuple[Parameter, ...]:
    """Control power of each axis: 1 where mass and inertia are declared and right, else one over the inertia."""
    declared = powers_declared(spec)
    unit, most = ("1", MOST) if declared else ("rad/m2" if spec.mass is None else "rad/(kg m2)", math.inf)
    sd, over = 1.0 if declared else math.inf, dict.fromkeys(MOMENTS, "what is declared")
    if any(motor.torque_ratio is None for motor in spec.motors):
        over["N"] = f"a torque of {TORQUE_ARM:g} arms times thrust (no torque_ratio is declared)"
    return tuple(
        Parameter(f"power.{axis}", 1.0, unit, (0.0, most), sd, doc=f"{about} by the rotors, over {over[axis]}")
        for axis, about in zip(MOMENTS, ("roll", "pitch", "yaw"), strict=True)
    )


def powers_declared(spec: ModelSpec) -> bool:
    """Whether places, mass and inertia say what the control powers are."""
    return spec.mass is not None and spec.inertia is not None and spec.found_places is None


def _trims(spec: ModelSpec, span: float) -> tuple[Parameter, ...]:
    units = dict.fromkeys(FORCES[:2], "m/s2") | dict.fromkeys(MOMENTS, "rad/s2")
    sd = {row: span * spec.sizes.get(f"row.{row}", 1.0) for row in units if row in spec.patterns}
    doc = "what is there whatever the rotors do"
    return tuple(Parameter(f"trim.{row}", 0.0, units[row], prior_sd=sd[row], doc=doc) for row in sd)


class Surfaces(Effect):
    """Elevons and whatever else moves beside the motors: forces and moments linear in each, about the reference.

    Source: Morelli and Klein, Aircraft System Identification (2nd ed.), sec. 3.3 (control derivatives).
    """

    id, stage, role = "surfaces", Stage.FORCES, Role.NOMINAL

    def __init__(
        self,
        rows: Sequence[str],
        controls: tuple[str, ...],
        declared: Sequence[Parameter],
        reference: Mapping[str, float],
    ) -> None:
        super().__init__(tuple(declared))
        self.rows, self.controls = tuple(rows), controls
        self.at = [reference.get(name, 0.0) for name in controls]

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds what the deflections do."""
        away = frame.stack(self.controls)
        away = away - away.new_tensor(self.at)
        zero = torch.zeros_like(away[..., 0])
        sums = [
            (p.stack(*(f"{row}.{c}" for c in self.controls)) * away).sum(-1) if row in self.rows else zero
            for row in (*FORCES, *MOMENTS)
        ]
        return frame.add(vec(*sums[:3]), vec(*sums[3:])), x


class RotorSpeed(Effect):
    """Speed that a rotor goes to under its command m: Omega0 (k0 + k1 sqrt(m/m0) + k2 m/m0), all rotors alike.

    Acts on the record of the commands, which it turns into speeds over the reference's, times m0: what follows on the
    control path (voltage, lag, delay) then acts on the speed. `Telemetry` tells them in rad/s.

    Source: Foerster, System Identification of the Crazyflie 2.0 (ETH, 2015), sec. 3.2 (command to rotor speed).
    """

    id, stage, order, role = "speed", Stage.CONTROL, -2, Role.NOMINAL

    def __init__(self, commands: tuple[str, ...], at: float) -> None:
        rows = (("k0", 0.0, "none"), ("k1", 1.0, "the root of the command"), ("k2", 0.0, "the command"))
        super().__init__(tuple(Parameter(n, v, "1", prior_sd=3.0, doc=f"rotor speed by {d}") for n, v, d in rows))
        self.commands, self.at = commands, at

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Commands as speeds over the reference's, times the reference's command."""
        share = record.clamp(min=LEAST_COMMAND * self.at) / self.at
        k0, k1, k2 = p.stack("k0", "k1", "k2")[..., None, None, :].unbind(-1)
        speed = self.at * (k0 + k1 * share.sqrt() + k2 * share)
        return torch.where(torch.tensor([n in self.commands for n in names], device=record.device), speed, record)


class Telemetry(Effect):
    """Rotor speeds as their telemetry tells them: what the commands make of them, rad/s."""

    id, stage, role = "telemetry", Stage.SENSORS, Role.NOMINAL

    def __init__(self, commands: tuple[str, ...], speeds: tuple[str, ...], factor: float) -> None:
        super().__init__()
        self.commands, self.speeds, self.factor = commands, speeds, factor

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """The speeds that follow from the commands in place of the measured ones."""
        speeds = {o: self.factor * frame.signals[m] for m, o in zip(self.commands, self.speeds, strict=True)}
        return frame.with_signals(**speeds), x


class Disturbance(Effect):
    """What else turns the body and hardly changes over a quarter of a second: gusts, rotors that are not alike.

    One state per axis that stays as it is. Where a segment begins it is small, a share `DISTURBED` of the usual angular
    acceleration; without it, output error would read integrated disturbances as errors of control power and lag. A free
    run has none of it.
    """

    id, stage, role = "disturbance", Stage.FORCES, Role.NOMINAL

    def __init__(self, sizes: Mapping[str, float]) -> None:
        spread = {row: DISTURBED * sizes.get(f"row.{row}", 1.0) for row in MOMENTS}
        states = (State(f"disturbance.{row}", "rad/s2", f"of {row}", spread=spread[row]) for row in MOMENTS)
        super().__init__((), tuple(states))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the disturbance, which stays."""
        return frame.add(moment=x), torch.zeros_like(x)
