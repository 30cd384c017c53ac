"""Effects of a multirotor's drives: motors' lag, voltage, rotors' inertia, drag, inflow, flapping, unlike rotors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Self

import torch
from torch import Tensor

from rotorid_torch.core.names import RATES, VELOCITIES, is_motor, thrust_share
from rotorid_torch.core.parameters import Parameter, alike
from rotorid_torch.core.rigid import cross, vec
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values
from rotorid_torch.effects.momentum import LEAST_INFLOW, USUAL_PITCH, USUAL_RATIO, Flow
from rotorid_torch.effects.registry import register
from rotorid_torch.effects.signal_operations import averaged, half_of, lagged
from rotorid_torch.effects.spec import USUAL_ARM, USUAL_MASS, ModelSpec, arm
from rotorid_torch.effects.testable import Needs, need

LARGE_SPEED = 1e3
"""rad/s: speeds of small rotors are thousands, where commands are one."""
VOLTAGE_S = 1.0
"""s: mean of a recorded voltage that a sensor's noise does not shake."""
NEXT_DISC = 0.8
"""Radius of a rotor over half the distance to the next one, usual among vehicles on sale."""
TRIED = (0.5, 1.0, 1.35, 1.8)
"""Induced velocities that are tried, over the usual: lift by speed and loss by climbing nearly cancel in wind."""
MOST_FEEDBACK = 0.6
"""Of z v_h/g, by which the induced velocity falls with the thrust: 1/3 at the usual solidity of 0.1, 1/2 at 0.2."""
LEAST_SHARE = 0.1
"""Of a rotor's usual command or speed, below which its disc leans no more."""
LEAST_VOLTAGE = 0.05
"""Share of the reference below which a voltage is a fault of its sensor."""


@register
class MotorLag(Effect):
    """Motors that follow their commands late: tau dm/dt = command - m, the same for all.

    Source: Foerster, System Identification of the Crazyflie 2.0 (ETH, 2015), sec. 3; Bouabdallah (EPFL, 2007).
    """

    id, stage, role = "propulsion.motor_lag", Stage.CONTROL, Role.UNDECLARED
    delays = "tau"
    needs = (Needs.MOTORS,)

    def __init__(self, motors: tuple[str, ...]) -> None:
        super().__init__((Parameter("tau", 0.0, "s", (0.0, 0.5), doc="time constant of the motors", typical=0.07),))
        self.motors = motors

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> MotorLag:
        """For the motor commands among the controls."""
        return cls(spec.commands)

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Controls [..., T, nu], motor commands behind the lag."""
        tau = torch.stack([p["tau"] if n in self.motors else torch.zeros_like(p["tau"]) for n in names], dim=-1)
        return lagged(record, tau, dt)


@register
class Voltage(Effect):
    """Battery voltage at the motors: commands, or the speeds that follow from them, count times (V/V_ref)^exponent.

    V = V_s + fast (V_m - V_s) with the measured voltage V_m and its means over a second V_s. The means show the
    battery's charge. Load draws the voltage down at once, with the commands, so that the curve of the rotors can stand
    for that; and a record that is late or noisy shows little of it. Its share `fast` is therefore estimated. A model
    that runs sample by sample takes the voltage as it comes. Faults of the sensor stay out; where nothing else is
    recorded within the second, commands count as at the reference.

    Source: Foerster, System Identification of the Crazyflie 2.0 (ETH, 2015), sec. 3.2 (thrust and battery).
    """

    id, stage, role = "propulsion.voltage", Stage.CONTROL, Role.UNDECLARED
    order = -1  # motors are late to follow what it makes of a command
    needs = (Needs.MOTORS, need(lambda spec: "voltage" in spec.inputs, "the channel voltage is missing"))
    averages: ClassVar[Mapping[str, float]] = {"voltage": VOLTAGE_S}

    def __init__(self, motors: tuple[str, ...], voltage: float) -> None:
        power, share = "power of the voltage in command or speed", "share of changes within a second that acts"
        super().__init__(
            (
                Parameter("exponent", 0.0, "1", (0.0, 4.0), doc=power, typical=1.0),
                Parameter("fast", 1.0, "1", (0.0, 1.0), prior_sd=0.5, doc=share, tried=(1.0, 0.0)),
            )
        )
        self.motors, self.voltage = motors, voltage

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Voltage:
        """About the reference voltage."""
        return cls(spec.commands, spec.reference["voltage"])

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Controls [..., T, nu], motor commands as the voltage lets them count."""
        share, half = record[..., names.index("voltage")] / self.voltage, half_of(VOLTAGE_S, dt)
        right = share >= LEAST_VOLTAGE
        zero, one = torch.zeros_like(share), torch.ones_like(share)
        total, part = averaged(torch.where(right, share, zero), half), averaged(torch.where(right, one, zero), half)
        mean = torch.where(part > 0.0, total, one) / torch.where(part > 0.0, part, one)
        acting = mean + p["fast"][..., None] * torch.where(right, share - mean, zero)
        factor = torch.exp(p["exponent"][..., None, None] * torch.log(acting[..., None]))
        counted = torch.tensor([n in self.motors for n in names], device=record.device)
        return torch.where(counted, record * factor, record)


SPINS = need(lambda spec: len(spec.spins) == len(spec.commands), "the spins of the motors are not declared")


@register
class RotorInertia(Effect):
    """Rotors that speed up turn the body: body and rotors keep their angular momentum about the yaw axis.

    What the torques integrate is r - N (sum of spin times command or speed, less that at the reference): the state r of
    the model. The rate itself is a signal and an output; its reaction to a sudden command is exact.

    Source: Mahony, Kumar and Corke, IEEE Robotics and Automation Magazine 19 (2012), eq. 6 (rotor acceleration).
    """

    id, stage, role = "propulsion.rotor_inertia", Stage.ENVIRONMENT, Role.UNDECLARED
    needs = (Needs.MOTORS, SPINS)

    def __init__(self, driven: tuple[str, ...], spins: tuple[float, ...], reference: dict[str, float]) -> None:
        size = 1.0 if driven[0] in reference and is_motor(driven[0]) else LARGE_SPEED
        unit, doc = "rad/s" if size == 1.0 else "1", "yaw rate by the sum of spin times command or speed"
        super().__init__((Parameter("N", 0.0, unit, (0.0, 20.0 / size), doc=doc, typical=2.0 / size),))
        self.driven, self.spins = driven, spins
        self.at = sum(s * reference.get(n, 0.0) for s, n in zip(spins, driven, strict=True))

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> RotorInertia:
        """With the declared spins."""
        return cls(spec.driven, spec.spins, spec.reference)

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """The rate of the body behind what the rotors have taken of the momentum."""
        total = sum((s * frame.signals[n] for s, n in zip(self.spins, self.driven, strict=True)), -self.at)
        return frame.with_signals(r=frame.signals["r"] + p["N"] * total), x


class _WithThrust(Effect):
    """Forces and moments by speed that grow with the rotors: with the sum of commands or speeds, 1 at the reference."""

    role = Role.UNDECLARED
    coefficients: ClassVar[tuple[Parameter, ...]] = ()

    def __init__(self, spec: ModelSpec) -> None:
        super().__init__(self.coefficients)
        self.driven, self.total = spec.driven, sum(spec.reference.get(n, 0.0) for n in spec.driven) or 1.0

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Self:
        """About the reference's commands or speeds."""
        return cls(spec)


BRAKING = "share of it by which each hub's own velocity brakes rates"
LONGEST = 2.0
"""Arms that are not declared are not longer than this times the usual one."""


def braking(spec: ModelSpec) -> Parameter:
    """The share h of a hub's own velocity that its rotor feels.

    No more than 1 where the arms are declared: beyond it inflow and drag trade with what the arms feel, and drag of the
    body takes their place. Where they are not, h is also the ratio of the true arms to the usual ones.
    """
    most = 1.0 if spec.found_places is None else LONGEST
    return Parameter("hubs", 1.0, "1", (0.0, most), prior_sd=0.5 * most, tried=(1.0, 0.0), doc=BRAKING)


class _AtHubs(_WithThrust):
    """What each rotor feels by the velocity of its hub through the air, v + h omega x place: it damps rates as well.

    h, `hubs`, is 1 where all of it acts at the rotors, and less where what stands in their wake or the body feels part
    of it about the centre of gravity.
    """

    stage = Stage.ROTOR
    needs = (Needs.MOTORS, Needs.VELOCITIES, Needs.FORCES)
    place: Tensor

    def __init__(self, spec: ModelSpec) -> None:
        super().__init__(spec)
        self.declared = (*self.declared, braking(spec))
        self.mass = spec.mass or 1.0
        place = torch.tensor([m.position for m in spec.motors], dtype=torch.float64)
        self.register_buffer("place", place, persistent=False)

    def _hubs(self, frame: Frame, p: Values) -> Tensor:
        """Velocities of the hubs through the air [..., motors, 3], m/s."""
        turning = cross(frame.stack(RATES).unsqueeze(-2), self.place)
        return frame.stack(VELOCITIES).unsqueeze(-2) + p["hubs"][..., None, None] * turning

    def _share(self, frame: Frame) -> Tensor:
        """Inputs of the rotors over the usual ones [..., motors, 1]."""
        return (frame.stack(self.driven) * (len(self.driven) / self.total)).unsqueeze(-1)

    def _each(self, specific: Tensor) -> Tensor:
        """Force of each rotor of a specific force that all make together, in units of thrust."""
        return specific * (self.mass / len(self.driven))


def usual_inflow(spec: ModelSpec) -> float:
    """Induced velocity of a multirotor's rotors in hover by momentum theory, m/s; discs nearly meet each other."""
    radius = NEXT_DISC * arm(spec) * math.sin(math.pi / max(len(spec.motors), 4))
    mass = spec.mass or USUAL_MASS * (arm(spec) / USUAL_ARM) ** 3
    return math.sqrt(mass * spec.gravity / (2.0 * spec.air_density * math.pi * radius**2 * len(spec.motors)))


@register
class RotorDrag(_AtHubs):
    """Drag of the rotors in their own plane, linear in speed: of the blades' profiles, and of thrust that leans back.

    At the reference each rotor's hub feels its part of -x u and -y v. A share `profile` of it grows with the rotor's
    command or speed s_i over that at the reference. The rest is thrust that leans, for discs tilt back with the speed
    over that of the blades' tips: it grows with thrust T_i over that at the reference, and with 1/s_i.

    Source: Faessler, Franchi and Scaramuzza, IEEE Robotics and Automation Letters 3 (2018); Mahony, Kumar and Corke,
    IEEE Robotics and Automation Magazine 19 (2012), eqs. 8 to 10 (thrust that leans); Foerster (2015), sec. 3.4.
    """

    id = "propulsion.rotor_drag"
    coefficients = (
        *alike("xy", "1/s", (0.0, 5.0), "drag in the rotors' plane along {}", typical=0.3),
        Parameter("profile", 1.0, "1", (0.0, 1.0), prior_sd=0.5, doc="share of it that grows with the rotors' speed"),
    )

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the forces."""
        share = self._share(frame)
        u, v, w = self._hubs(frame, p).unbind(-1)
        along, across = p.stack("x", "y").unsqueeze(-2).unbind(-1)
        drag = self._each(vec(-along * u, -across * v, torch.zeros_like(w)))
        profile, tips = p["profile"][..., None, None], share.clamp(min=LEAST_SHARE)
        return frame.add_at_hubs(share * profile * drag).add_leaning((1.0 - profile) * drag / tips), x


@register
class AxialInflow(_AtHubs):
    """Thrust by flow through the rotors: lost in a climb, gained by speed across, which carries the wake away.

    Blade elements and momentum theory of each rotor: with T_h its thrust in hover at its speed, sigma = sqrt(T_h/T_0)
    that speed over the one at the reference, V_c = -w the climb of its hub, V its speed across,
    T = T_h - k (sigma (v + V_c - sigma v_h) - pitch V^2), v sqrt(V^2 + (v + V_c)^2) = v_h^2 T/T_0,
    k = 2 z/(1 - z v_h/g). Slow climbing costs z V_c; speed across, or wind, brings lift. Beyond z v_h/g = 0.6, which no
    propeller has, k stays 5 z and v depends on T by less, so that slow climbing costs z V_c still.

    Source: Leishman, Principles of Helicopter Aerodynamics, sec. 2.14 (momentum theory in forward flight), 3.3 and 3.5
    (blade elements in climb and forward flight); Foerster, System Identification of the Crazyflie 2.0 (ETH, 2015),
    sec. 3.4.
    """

    id = "propulsion.axial_inflow"

    def __init__(self, spec: ModelSpec) -> None:
        super().__init__(spec)
        usual, doc = usual_inflow(spec), "induced velocity in hover"
        tried, bounds = tuple(share * usual for share in TRIED), (0.0, 10.0 * usual)
        hover = Parameter("hover", usual, "m/s", bounds, 0.3 * usual, doc=doc, typical=usual, tried=tried)
        pitch, doc = USUAL_PITCH * USUAL_RATIO / usual, "pitch of the blades over the speed of their tips"
        turning = Parameter("pitch", pitch, "rad s/m", (0.0, 10.0 * pitch), pitch, doc=doc)
        most, doc = spec.gravity / usual, "thrust lost by slow climbing"
        loss = Parameter("z", 0.0, "1/s", (0.0, most), doc=doc, typical=0.3)
        self.declared = (loss, *self.declared, hover, turning)
        self.gravity = spec.gravity

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Says what flows through the rotors."""
        u, v, w = self._hubs(frame, p).unbind(-1)
        z, hover, pitch = p.stack("z", "hover", "pitch").unsqueeze(-2).unbind(-1)
        feedback = torch.clamp(z * hover / self.gravity, max=MOST_FEEDBACK)
        most = MOST_FEEDBACK * self.gravity / hover.clamp(min=LEAST_INFLOW)
        loss, felt = (2.0 * cost / (self.gravity * (1.0 - feedback)) for cost in (z, torch.minimum(z, most)))
        return replace(frame, flow=Flow(u * u + v * v, -w, hover, loss, felt, pitch)), x


@register
class Flapping(_WithThrust):
    """Blades that flap back turn the body: moments by the speed across the rotors' axes, alike about both axes.

    Of each of n rotors, M += k f u/n - a k sigma f v/n and L -= (I_yy/I_xx) (k f v + a k sigma f u)/n, with sigma its
    spin: an advancing blade rises, and the disc tilts back and, as blades are stiff, to the side of the retreating one.
    f = s - e ((v_i + V_c)/v_h - s): less tilt where more air flows through the disc. s is the speed of the rotor over
    that at the reference (of commands the root of the declared thrust, else s itself), V_c = -w the climb, v_i the
    induced velocity by momentum theory: that of the model's inflow, or of the usual v_h in hover. The stiffness of the
    blades at the hub grows with s^2, as a hinge's offset does.

    Source: Bramwell, Helicopter Dynamics, ch. 3 (tilt by speed: mu (8/3 theta - 2 lambda)); Hoffmann, Huang, Waslander
    and Tomlin, AIAA 2007-6461, sec. III (blade flapping); Mahony, Kumar and Corke, IEEE Robotics and Automation
    Magazine 19 (2012), eq. 8 (tilt back and to the side).
    """

    id, stage = "propulsion.flapping", Stage.FORCES
    separated_by = "flights with the controller off, or a wind tunnel"
    _about = "pitch by speed ahead, roll by speed to the left"
    coefficients = (Parameter("k", 0.0, "rad/(s m)", (0.0, 100.0), doc=_about, typical=1.0),)
    needs = (Needs.MOTORS, Needs.VELOCITIES, Needs.RATES)

    def __init__(self, spec: ModelSpec) -> None:
        super().__init__(spec)
        self.hover, self.at = usual_inflow(spec), self.total / len(self.driven)
        curves = [m.thrust for m in spec.motors if m.thrust is not None]
        self.curve = tuple(sum(c) / len(c) for c in zip(*curves, strict=True)) if curves else (0.0, 0.0, 1.0)
        self.roll = 1.0 if spec.inertia is None else spec.inertia[1][1] / spec.inertia[0][0]
        self.spins = spec.spins if len(spec.spins) == len(spec.driven) else ()
        if self.spins:
            aside = Parameter("aside", 0.0, "1", (0.0, 3.0), 0.5, doc="tilt to the side over tilt back, of a disc")
            self.declared = (*self.declared, aside)

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the moments."""
        s = self._speed(frame.stack(self.driven))  # [..., motors]
        u, v, w = frame.stack(VELOCITIES).unbind(-1)
        across, climb = (one.unsqueeze(-1) for one in (u * u + v * v, -w))
        calm = torch.zeros_like(climb)
        flow = frame.flow or Flow(across, climb, calm + self.hover, calm, calm, calm)
        tilt = p["k"][..., None] * s * flow.tilt(s)
        back, aside = tilt.mean(-1), torch.zeros_like(u)
        if self.spins:
            aside = p["aside"] * (tilt * tilt.new_tensor(self.spins)).mean(-1)
        roll, pitch = -self.roll * (back * v + aside * u), back * u - aside * v
        return frame.add(moment=vec(roll, pitch, torch.zeros_like(u))), x

    def _speed(self, inputs: Tensor) -> Tensor:
        """Of each rotor over that at the reference, by its command or speed [..., motors]."""
        c0, c1, c2 = self.curve
        share = (c0 + inputs * (c1 + inputs * c2)) / (c0 + self.at * (c1 + self.at * c2))
        return torch.sqrt(torch.clamp(share, min=LEAST_SHARE**2))


PLACES = need(lambda spec: bool(spec.motors) and spec.found_places is None, "the motors' places are not declared")


@register
class Unequal(Effect):
    """Rotors that give less than the others at the same command or speed: a damaged propeller, a tired motor.

    T_i = T (1 - less_i), its torque likewise. Averaged over flights the trims of the moments stand for it; where the
    thrusts balance, and how yaw does, tells which rotor it is.

    Source: Mahony, Kumar and Corke, IEEE Robotics and Automation Magazine 19 (2012), eq. 5 (a rotor's thrust).
    """

    id, stage, role = "propulsion.unequal", Stage.ROTOR, Role.UNDECLARED
    separated_by = "flights before and after a propeller is changed"
    rotors_absorb = "rotors.trim"  # it is there whatever the rotors do
    needs = (Needs.MOTORS, PLACES)

    def __init__(self, driven: tuple[str, ...]) -> None:
        super().__init__(alike(driven, "1", (-0.5, 0.9), "share of its thrust that the rotor lacks", typical=0.1))
        self.driven = driven

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Unequal:
        """Of each rotor."""
        return cls(spec.driven)

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Says what each rotor gives of its thrust."""
        return frame.with_signals(**{thrust_share(n): 1.0 - p[n] for n in self.driven}), x
