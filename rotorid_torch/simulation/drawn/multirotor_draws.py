"""Multirotors drawn in the likeness of the one that a data set is about: what is declared, and chance where nothing is.

Places, spins, mass, how commands hover and the effects that a model of the data has are the data's; propellers, thrust
curves, inertia (within a tenth of the declared one), how rotors of one kind differ, the controller's noise and the
constants of the sensors are drawn.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from rotorid_torch.core.names import SPECIFIC_FORCES
from rotorid_torch.data import Dataset
from rotorid_torch.data.schema import Vehicle
from rotorid_torch.simulation.multirotor.craft import Battery, Drive, Multirotor, Propeller
from rotorid_torch.simulation.multirotor.flight import Fleet, Hover
from rotorid_torch.simulation.multirotor.hidden import of_size
from rotorid_torch.simulation.multirotor.rotor import Blades
from rotorid_torch.simulation.multirotor.vehicles import with_unlike_rotors
from rotorid_torch.simulation.rigid import Array

SHORT_CUT = 0.378
"""What the controller's filter leaves of a sample of its gyros' noise."""
QUIETEST, LOUDEST = 2e-4, 0.05
"""rad/s: noise of the gyros that a controller reads."""


@dataclass(frozen=True)
class Hovering:
    """How the flights hover: mean command of each motor; mean speed of the rotors, rad/s, where it is measured.

    `white` : standard deviation of a sample of a command that no motion explains; `voltage` : mean, V, or 1.
    """

    commands: Array
    speed: float | None
    white: float
    voltage: float


def hovering(dataset: Dataset) -> Hovering:
    """Means over the identify flights, which turn and climb about hover."""
    flights = [dataset.flights[name] for name in dataset.identify]

    def mean(channel: str) -> float:
        return float(np.nanmean(np.concatenate([f.channels[channel].numpy() for f in flights if f.has(channel)])))

    commands = np.array([mean(motor) for motor in dataset.controls])
    speeds = [f"omega{motor.removeprefix('motor')}" for motor in dataset.controls]
    measured = all(f.has(*speeds) for f in flights)
    speed = float(np.mean([mean(one) for one in speeds])) if measured else None
    voltage = mean("voltage") if any(f.has("voltage") for f in flights) else 1.0
    return Hovering(commands, speed, float(np.median([dataset.noise(motor) for motor in dataset.controls])), voltage)


def draw(
    dataset: Dataset, hover: Hovering, chance: np.random.Generator, effects: Mapping[str, Mapping[str, float]]
) -> Multirotor:
    """A vehicle of the data set's frame with these effects, of the sizes that the library's parameters have."""
    vehicle, dt = dataset.vehicle, min(facts.dt for facts in dataset.facts.values())
    places = tuple(motor.position for motor in vehicle.motors)
    mass = 1.0 if vehicle.mass is None else vehicle.mass
    bare = Multirotor(
        name=f"{dataset.name}-drawn",
        mass=mass,
        inertia=_inertia(vehicle, mass, chance),
        places=places,
        spins=tuple(1 if motor.spin == "ccw" else -1 for motor in vehicle.motors),
        lifts=(1.0,) * len(places),
        propeller=_propeller(places, chance),
        drive=Drive(1.0, 0.0, _exponent(vehicle, hover, chance)),
        battery=Battery(hover.voltage, 0.9 * hover.voltage, 0.0, 1e9, hover.voltage),
        speed=1.0,
        height=1.0,
        rate=max(round(1.0 / dt), 1),
        imu=vehicle.imu or (0.0, 0.0, 0.0),
        unsteady=float(chance.uniform(0.001, 0.006)),
        gravity=vehicle.gravity,
        air_density=vehicle.air_density,
        telemetry=hover.speed is not None,
        tilt=float(chance.uniform(0.0, 0.01)),
        offsets=(float(chance.uniform(0.0, 0.004)), float(chance.uniform(0.0, 0.08))),
    )
    craft = with_unlike_rotors(_loud(_turning(bare, hover), hover.white), chance)
    for effect, values in effects.items():
        craft = of_size(craft, effect, values)
    return craft


def hover_balance(craft: Multirotor) -> Array:
    """Where a vehicle's thrusts seem to balance while it hovers, as if all rotors were alike, [3].

    Thrust centre x, y in m from the declared centre of gravity, and the share of the thrust by which rotors that turn
    counter-clockwise exceed the others.
    """
    meant, actual = _hover(craft.with_like_rotors()), _hover(craft)
    (x, y), spins = np.asarray(craft.places)[:, :2].T, np.array(craft.spins)
    mixer = np.linalg.pinv(np.stack([np.ones(craft.count), -y, x, spins * meant.ratio[:, 0]]))
    yaw = spins * actual.ratio[:, 0] + x * craft.lean[1] - y * craft.lean[0]
    moved = np.stack([np.ones(craft.count), -y, x, yaw]) * (actual.curve / meant.curve)[:, 0]
    thrust = mixer @ np.linalg.solve(moved @ mixer, np.eye(4)[0])
    return np.stack([x, y, spins]) @ thrust / thrust.sum()


def _inertia(vehicle: Vehicle, mass: float, chance: np.random.Generator) -> tuple:
    """The declared tensor within a tenth, or that of a body half as wide as its arms are long."""
    if vehicle.inertia is not None:
        shares = np.sqrt(chance.uniform(0.9, 1.1, 3))
        tensor = np.asarray(vehicle.inertia) * np.outer(shares, shares)
        principal = np.linalg.eigvalsh(tensor)
        tensor = tensor if principal[2] < 0.999 * (principal[0] + principal[1]) else np.asarray(vehicle.inertia)
    else:
        arm = np.sqrt((np.array([motor.position for motor in vehicle.motors])[:, :2] ** 2).sum(1).mean())
        across = mass * (0.5 * arm) ** 2 * chance.uniform(0.8, 1.2, 2)
        tensor = np.diag([*across, 0.88 * across.sum()])
    return tuple(tuple(float(x) for x in row) for row in tensor)


def _propeller(places: tuple, chance: np.random.Generator) -> Propeller:
    """As large as the places of the rotors leave room for."""
    across = np.asarray(places)[:, :2]
    apart = np.linalg.norm(across[:, None] - across[None], axis=-1)
    widest = apart.max()
    nearest = np.where(apart > 0.1 * widest, apart, np.inf).min()
    radius = float(0.5 * nearest * chance.uniform(0.75, 0.95))
    return Propeller(
        radius=radius,
        chord=float(chance.uniform(0.14, 0.22)) * radius,
        blades=2,
        pitch=float(chance.uniform(0.28, 0.4)),
        twist=float(chance.uniform(-0.22, -0.1)),
        stiffness=float(chance.uniform(0.2, 0.8)),
    )


def _exponent(vehicle: Vehicle, hover: Hovering, chance: np.random.Generator) -> float:
    """Power of the command in the speed: half of that in the declared thrust at hover, or chance."""
    curve, at = vehicle.motors[0].thrust, float(hover.commands.mean())
    if curve is not None and hover.speed is None:
        thrust, slope = curve[0] + curve[1] * at + curve[2] * at**2, curve[1] + 2.0 * curve[2] * at
        if thrust > 0.0 and slope > 0.0:
            return float(np.clip(0.5 * at * slope / thrust, 0.4, 1.3))
    return float(chance.choice([0.5, 0.7, 1.0]))


def _turning(bare: Multirotor, hover: Hovering) -> Multirotor:
    """Blades as deep as the measured speed asks for, and a motor that hovers at the mean command."""
    craft = bare
    if hover.speed is not None:
        for _ in range(12):
            blade, share = craft.propeller, float(_hover(craft).speed.mean()) / hover.speed
            craft = replace(craft, propeller=replace(blade, chord=blade.chord * share**2.5))
    at = float(np.clip(hover.commands.mean(), 0.05, 0.9))
    full = float(_hover(craft).speed.mean()) / at**craft.drive.exponent
    return replace(craft, drive=replace(craft.drive, full_speed=full))


def _hover(craft: Multirotor) -> Hover:
    return Hover.of([craft], Blades.of([craft.propeller], np.array([craft.air_density])))


def _loud(craft: Multirotor, white: float) -> Multirotor:
    """With gyros whose noise makes the controller's commands as rough as the measured ones are."""
    fleet = Fleet.of([craft], [craft])
    control, hover = fleet.controller(), fleet.hover
    share = np.array([1.0, 1.0, 0.4]) * np.diag(craft.inertia_matrix) * control.gains[3, 0] * SHORT_CUT
    thrust = np.sqrt(((control.allocation[:, 1:, 0] * share) ** 2).sum(1)).mean()
    speed = float(hover.speed.mean())
    command = craft.drive.command_at(speed)
    slope = 2.0 * float(hover.curve.mean()) * speed**2 * craft.drive.exponent / max(command, 0.05)
    return replace(craft, gyro=float(np.clip(white * slope / thrust, QUIETEST, LOUDEST)))


def noise_of(dataset: Dataset) -> dict[str, float]:
    """Standard deviation of a sample of each channel of the flights; commands are exact."""
    channels = {name for flight in dataset.flights.values() for name in flight.channels}
    skipped = {"time", "voltage", *dataset.controls}
    wanted = [name for name in channels - skipped if name in dataset.channel_specs or _is_sensor(name)]
    return {name: dataset.noise(name) for name in wanted}


def _is_sensor(name: str) -> bool:
    sensors = ("u", "v", "w", "p", "q", "r", "phi", "theta", "psi", "north", "east", "height", *SPECIFIC_FORCES)
    return name in sensors or name.rstrip("0123456789") == "omega"
