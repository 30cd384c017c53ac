"""Effects of a multirotor's drives: lag of the motors, battery voltage, the rotors' inertia and drag."""

from __future__ import annotations

import torch
from torch import Tensor

from rotorid_torch.core.names import VELOCITIES, is_motor
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.rigid import vec
from rotorid_torch.core.state import State
from rotorid_torch.effects.base import Effect, Frame, Role, Showing, Stage, Values
from rotorid_torch.effects.record import lagged
from rotorid_torch.effects.registry import register
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.effects.testable import first, no_channel, no_forces, no_motors, no_velocities


def motors_of(spec: ModelSpec) -> tuple[str, ...]:
    """Names of the motor commands."""
    return tuple(c for c in spec.controls if is_motor(c))


@register
class MotorLag(Effect):
    """Motors that follow their commands late: tau dm/dt = command - m, the same for all.

    Source: Foerster, System Identification of the Crazyflie 2.0 (ETH, 2015), sec. 3; Bouabdallah (EPFL, 2007).
    """

    id, stage, role = "propulsion.motor_lag", Stage.CONTROL, Role.UNDECLARED

    def __init__(self, motors: tuple[str, ...]) -> None:
        super().__init__((Parameter("tau", 0.0, "s", (0.0, 0.5), doc="time constant of the motors", typical=0.07),))
        self.motors = motors

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> MotorLag:
        """For the motor commands among the controls."""
        return cls(motors_of(spec))

    @classmethod
    def untestable(cls, spec: ModelSpec) -> str | None:
        """Without motors."""
        return no_motors(spec)

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Controls [..., T, nu], motor commands behind the lag."""
        tau = torch.stack([p["tau"] if n in self.motors else torch.zeros_like(p["tau"]) for n in names], dim=-1)
        return lagged(record, tau, dt)


@register
class Voltage(Effect):
    """Battery voltage in the thrust: commands count times (V/V_ref)^exponent; the voltage falls with the commands.

    dV/dt = -sag (mean command); the voltage is a state that starts at its channel.

    Source: Foerster, System Identification of the Crazyflie 2.0 (ETH, 2015), sec. 3.2 (thrust and battery).
    """

    id, stage, role, showing = "propulsion.voltage", Stage.ENVIRONMENT, Role.UNDECLARED, Showing.OTHER_FLIGHTS
    predicts = ("voltage",)

    def __init__(self, motors: tuple[str, ...], voltage: float) -> None:
        super().__init__(
            (
                Parameter("exponent", 0.0, "1", (0.0, 4.0), doc="power of the voltage in the thrust", typical=1.5),
                Parameter("sag", 0.0, "V/s", (0.0, 1.0), doc="fall of the voltage at full command", typical=0.01),
            ),
            (State("voltage", "V", "battery voltage", "voltage"),),
        )
        self.motors, self.voltage = motors, voltage

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Voltage:
        """About the reference voltage."""
        return cls(motors_of(spec), spec.reference["voltage"])

    @classmethod
    def untestable(cls, spec: ModelSpec) -> str | None:
        """Without motors or voltage."""
        return first(no_motors(spec), no_channel(spec, "voltage"))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Commands as the voltage lets them count; the voltage's rate."""
        factor = torch.exp(p["exponent"] * torch.log((x[..., 0] / self.voltage).clamp(min=0.05)))
        commands = frame.stack(self.motors)
        counted = (commands * factor.unsqueeze(-1)).unbind(-1)
        frame = frame.with_signals(voltage=x[..., 0], **dict(zip(self.motors, counted, strict=True)))
        return frame, (-p["sag"] * commands.mean(-1)).unsqueeze(-1)


@register
class RotorInertia(Effect):
    """Reaction to rotors that speed up: N += k d(sum of spin x command)/dt, the rate through a lag of tau.

    Source: Mahony, Kumar and Corke, IEEE Robotics and Automation Magazine 19 (2012), eq. 6 (rotor acceleration).
    """

    id, stage, role = "propulsion.rotor_inertia", Stage.FORCES, Role.UNDECLARED

    def __init__(self, motors: tuple[str, ...], spins: tuple[float, ...], reference: dict[str, float]) -> None:
        super().__init__(
            (
                Parameter(
                    "N", 0.0, "rad/s", (0.0, 20.0), doc="yaw by the rate of the commands' difference", typical=0.5
                ),
                Parameter("tau", 0.05, "s", (0.02, 0.3), 0.03, doc="in which the rotors follow", typical=0.05),
            ),
            (State("difference", "1", "sum of spin times command that the rotors have reached"),),
        )
        self.motors, self.spins = motors, spins

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> RotorInertia:
        """With the declared spins."""
        return cls(motors_of(spec), spec.spins, spec.reference)

    @classmethod
    def untestable(cls, spec: ModelSpec) -> str | None:
        """Without motors or their spins."""
        spins = None if len(spec.spins) == len(motors_of(spec)) else "the spins of the motors are not declared"
        return first(no_motors(spec), spins)

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the reaction; the rate of what the rotors have reached."""
        wanted = sum((s * frame.signals[m] for s, m in zip(self.spins, self.motors, strict=True)), 0.0 * x[..., 0])
        rate = (wanted - x[..., 0]) / p["tau"]
        yaw = p["N"] * rate
        zero = torch.zeros_like(yaw)
        return frame.add(moment=vec(zero, zero, yaw)), rate.unsqueeze(-1)


@register
class RotorDrag(Effect):
    """Drag of the rotors in their own plane and along it, linear in speed, growing with the commands.

    X -= xy s u, Y -= xy s v, Z -= z s w with s the sum of the commands over its reference.

    Source: Faessler, Franchi and Scaramuzza, IEEE Robotics and Automation Letters 3 (2018); Foerster (2015), sec. 3.4.
    """

    id, stage, role, showing = "propulsion.rotor_drag", Stage.FORCES, Role.UNDECLARED, Showing.ABSORBED

    def __init__(self, motors: tuple[str, ...], total: float) -> None:
        super().__init__(
            (
                Parameter("xy", 0.0, "1/s", (0.0, 5.0), doc="drag in the rotors' plane", typical=0.3),
                Parameter("z", 0.0, "1/s", (0.0, 5.0), doc="drag along the rotors' axes", typical=0.3),
            )
        )
        self.motors, self.total = motors, total

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> RotorDrag:
        """About the reference's commands."""
        motors = motors_of(spec)
        return cls(motors, sum(spec.reference.get(m, 0.0) for m in motors) or 1.0)

    @classmethod
    def untestable(cls, spec: ModelSpec) -> str | None:
        """Without motors or velocities."""
        return first(no_motors(spec), no_velocities(spec), no_forces(spec))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the drag."""
        share = frame.stack(self.motors).sum(-1, keepdim=True) / self.total
        return frame.add(force=-p.stack("xy", "xy", "z") * share * frame.stack(VELOCITIES)), x
