"""Rotor speed that gives way to the load, and its governor."""

from __future__ import annotations

import torch
from torch import Tensor

from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.rigid import vec
from rotorid_torch.core.state import State
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values
from rotorid_torch.effects.families.main_rotor import KNOWN, LIFT_SLOPE, USUAL_LOCK
from rotorid_torch.effects.registry import register
from rotorid_torch.effects.spec import ModelSpec, RotorSpec
from rotorid_torch.effects.testable import Needs, need

USUAL_SHARE, MOST_SHARE = 0.15, 0.9
"""Inertia of the rotor about its shaft over that of the body in yaw: where the latter is not declared, and at most."""
LOADS = {"rad": ("1/s2", 30.0, "rad"), "m": ("rad/(s2 m)", 30.0, "m"), "norm": ("rad/s2", 10.0, "1")}
"""Unit and size of the deceleration by a collective in its unit, where the power that it costs is not in the model."""


@register
class RotorSpeed(Effect):
    """Rotor speed and its governor: power slows the rotor, the engine brings it back; thrust and torque change.

    ds/dt = e - dP; de/dt = -governor s - rate ds/dt, with dP = T (vi - w) beyond trim, the power of lift and
    climb per mass, or the collective's excursion where the model has no inflow. load s is the speed beyond trim
    (rad/s). Z += Z load s; N += N load ds/dt: the engine turns the body as it speeds the rotor up, while the torques of
    main and tail rotor, which hold each other, go with the square of the speed alike. Z is -2 g/speed, thrust as the
    speed squared, free where the speed is measured, for otherwise load and Z tell the same story; N starts as the
    rotor's inertia over the body's.

    Source: Hilbert, NASA TM-85890 (1984), table 3; Padfield, Helicopter Flight Dynamics, sec. 3.2.5 (governor).
    """

    id, stage, role, predicts = "rotor.speed", Stage.FORCES, Role.STRUCTURE, ("omega",)
    needs = (Needs.ROTOR, Needs.FORCES, need(lambda spec: "col" in spec.controls, "the collective is not recorded"))

    def __init__(self, spec: ModelSpec, rotor: RotorSpec) -> None:
        thrust, share = -2.0 * spec.gravity / rotor.speed, rotor.spin * _share(spec, rotor)
        unit, load, over = LOADS.get(spec.control_units.get("col", "rad"), LOADS["norm"])
        at, spread = spec.reference, KNOWN
        if spec.inflow:
            assert spec.mass is not None
            unit, load, over = "rad s/m2", spec.mass / (_inertia(spec, rotor) * rotor.speed), "m2/s3"
            spread = KNOWN * spec.lift * at["vi"]
        measured = "omega" in spec.outputs
        super().__init__(
            (
                Parameter(
                    "load", 0.0, unit, (0.0, 40.0 * load), doc="deceleration by power or collective", typical=load
                ),
                Parameter("governor", 6.0, "1/s2", (0.2, 60.0), 6.0, doc="engine's answer to the speed", typical=6.0),
                Parameter("rate", 2.0, "1/s", (0.0, 20.0), 2.0, doc="the same to its rate", typical=2.0),
                Parameter("Z", thrust, "m/(s rad)", (4.0 * thrust, 0.0), -thrust, measured, "thrust by speed", thrust),
                Parameter("N", share, "1", (-1.0, 1.0), abs(share), doc="yaw as the rotor speeds up", typical=share),
            ),
            (
                State("speed", f"{over} s", "speed beyond trim by load", spread=spread),
                State("engine", over, "engine beyond trim by load", spread=spread),
            ),
        )
        self.by_power, self.col, self.omega = spec.inflow, at.get("col", 0.0), at.get("omega", rotor.speed)
        self.power = spec.lift * (at["vi"] - at["w"]) if spec.inflow else 0.0

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> RotorSpeed:
        """From the declared rotor, mass and inertia, and the measured speed's mean where it is a channel."""
        assert spec.rotor is not None
        return cls(spec, spec.rotor)

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds thrust and torque; publishes the speed."""
        behind = x[..., 1] - self._load(frame)
        engine = -p["governor"] * x[..., 0] - p["rate"] * behind
        speed, faster = p["load"] * x[..., 0], p["load"] * behind
        zero = torch.zeros_like(speed)
        frame = frame.add(vec(zero, zero, p["Z"] * speed), vec(zero, zero, p["N"] * faster))
        return frame.with_signals(omega=self.omega + speed), vec(behind, engine)

    def _load(self, frame: Frame) -> Tensor:
        if not self.by_power:
            return frame.signals["col"] - self.col
        assert frame.force is not None
        return -frame.force[..., 2] * (frame.signals["vi"] - frame.signals["w"]) - self.power


def _inertia(spec: ModelSpec, rotor: RotorSpec) -> float:
    """Inertia of the rotor about its shaft, kg m2: its blades' by the Lock number, rho a c R^4 over theirs."""
    blade = spec.air_density * LIFT_SLOPE * rotor.chord * rotor.radius**4 / (rotor.lock_number or USUAL_LOCK)
    return rotor.blades * blade


def _share(spec: ModelSpec, rotor: RotorSpec) -> float:
    """The same over the body's in yaw."""
    return USUAL_SHARE if spec.inertia is None else min(_inertia(spec, rotor) / spec.inertia[2][2], MOST_SHARE)
