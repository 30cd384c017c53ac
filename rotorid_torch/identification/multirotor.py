"""What a data set declares and measures of a multirotor's drives."""

from __future__ import annotations

from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.spec import MotorSpec


def spins(dataset: Dataset) -> tuple[float, ...]:
    """Of the declared motors, +1 for counter-clockwise seen from above."""
    return tuple(1.0 if motor.spin == "ccw" else -1.0 for motor in dataset.vehicle.motors)


def motors(dataset: Dataset) -> tuple[MotorSpec, ...]:
    """The declared motors of a multirotor; none where their places are not declared."""
    if dataset.kind != "multirotor":
        return ()
    return tuple(
        MotorSpec(position=m.position, spin=spin, thrust=m.thrust, torque_ratio=m.torque_ratio)
        for m, spin in zip(dataset.vehicle.motors, spins(dataset), strict=True)
    )


def rotor_speeds(dataset: Dataset) -> tuple[str, ...]:
    """Channels of the rotors' speeds where every flight has all of them, one per motor command."""
    wanted = tuple(f"omega{control.removeprefix('motor')}" for control in dataset.controls)
    return wanted if motors(dataset) and _every_flight_has(dataset, wanted) else ()


def measured_inputs(dataset: Dataset) -> tuple[str, ...]:
    """Measured quantities besides the commands that drive a multirotor: rotor speeds, battery voltage."""
    battery = ("voltage",) if motors(dataset) and _every_flight_has(dataset, ("voltage",)) else ()
    return (*rotor_speeds(dataset), *battery)


def _every_flight_has(dataset: Dataset, channels: tuple[str, ...]) -> bool:
    return all(facts.has(*channels) for facts in dataset.facts.values())
