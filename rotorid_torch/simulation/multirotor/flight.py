"""The time loop: many multirotors side by side, each in a flight of its own, controlled, driven and blown about.

Rows are components or rotors, columns flights: [3, column], [rotor, column]. Forces are constant over a step of `STEP`,
as commands are; attitude and place follow by the trapezoidal rule.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from rotorid_torch.simulation.helicopter.slung_load import SlungLoad, Surroundings, cable_pull, swing_rates
from rotorid_torch.simulation.multirotor.control import Controller, Pose, Targets
from rotorid_torch.simulation.multirotor.craft import Multirotor
from rotorid_torch.simulation.multirotor.drive import Drives
from rotorid_torch.simulation.multirotor.rotor import Blades, Flow
from rotorid_torch.simulation.multirotor.surroundings import ground_share, turbulence
from rotorid_torch.simulation.rigid import Array, cross, dot, to_earth, turned

STEP = 0.0025
"""s: period of the controller and step of the integration, at most."""
ENTRY, WINDY_ENTRY = 4.0, 14.0
"""s of hover before the record begins, in still air and in wind: integrals settle, and loads."""
UNSTEADY = 0.03
"""s: how long a rotor's own wake keeps its thrust off its mean."""
UNFELT = 1e-6
"""Share of the velocity through the air by which rotors that flap drag at least."""
CHUNK = 400
"""Steps for which chance is drawn at a time."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Hover:
    """Hover of vehicles side by side, [rotor, column] each: speed, rad/s, induced velocity, m/s, torque over thrust, m.

    `curve` : thrust over the square of the speed, N s^2, with the wake of a rotor above.
    """

    speed: Array
    induced: Array
    curve: Array
    ratio: Array

    @classmethod
    def of(cls, craft: Sequence[Multirotor], blades: Blades) -> Hover:
        """With all rotors at one speed: blade elements and momentum theory, which go with the square of the speed."""
        count, columns = craft[0].count, len(craft)
        one, density = np.ones((count, columns)), blades.density
        strength = np.array([v.lifts for v in craft]).T
        still, loss = blades.thrust_parts(one, 0.0, strength)
        flow = 2.0 * density * blades.disc
        induced = np.zeros((count, columns))
        wake = craft[0].wake * craft[0].above
        for _ in range(3):  # a rotor below takes the wake of the one above, which no rotor disturbs
            reduced = still - loss * (wake @ induced)
            induced = (np.sqrt(loss * loss + 4.0 * flow * reduced) - loss) / (2.0 * flow)
        calm = Flow(wake @ induced, 0.0 * one, np.zeros((2, count, columns)))
        loads = blades.loads(one, induced, calm, strength, one)
        weight = np.array([v.mass * v.gravity for v in craft])
        speed = np.sqrt(weight / loads.thrust.sum(0)) * one
        return cls(speed, induced * speed, loads.thrust, loads.torque / loads.thrust)


@dataclass(frozen=True)
class Fleet:
    """Vehicles of one frame side by side, a column each, and as their makers think that they are (`clean`).

    `step` : of the integration and period of the controllers, s; each `every`th is recorded.
    """

    craft: tuple[Multirotor, ...]
    clean: tuple[Multirotor, ...]
    blades: Blades
    drives: Drives
    hover: Hover
    step: float
    every: int

    @classmethod
    def of(cls, craft: Sequence[Multirotor], clean: Sequence[Multirotor], dt: float | None = None) -> Fleet:
        """All with equally many rotors; `dt` : of the record, s, by default that of the first vehicle's rate."""
        dt = 1.0 / craft[0].rate if dt is None else dt
        every = int(np.ceil(dt / STEP - 1e-6))
        blades = Blades.of([v.propeller for v in craft], np.array([v.air_density for v in craft]))
        hover = Hover.of(craft, blades)
        return cls(tuple(craft), tuple(clean), blades, Drives.of(craft, hover.speed[0]), hover, dt / every, every)

    def controller(self) -> Controller:
        """Their controllers; what a maker measures on the bench is the hover of the clean vehicle, rotors alike."""
        blades = Blades.of([v.propeller for v in self.clean], np.array([v.air_density for v in self.clean]))
        hover = Hover.of([v.with_like_rotors() for v in self.clean], blades)
        return Controller.of(self.clean, self.craft, hover.curve, hover.ratio)


@dataclass(frozen=True)
class FleetHistory:
    """Flights sample by sample, [T, ..., column]; places and velocities in north east down, body axes else.

    `force` (N) and `moment` (N m) act on the body without gravity, about its centre of gravity; `specific_force` m/s^2,
    `angular` rad/s^2; `speeds` of the rotors rad/s, `commands` 0..1. `air` : its velocity, north east down; `spared` :
    mean share of the induced velocity that the ground takes away; `swing` : direction of the cable, north and east.
    """

    time: Array
    place: Array
    velocity: Array
    euler: Array
    rates: Array
    specific_force: Array
    angular: Array
    force: Array
    moment: Array
    speeds: Array
    commands: Array
    voltage: Array
    air: Array
    spared: Array
    swing: Array


@dataclass(frozen=True)
class Task:
    """What is flown: `names` of the flights, a column each (streams of chance go by them), and for how many samples.

    `targets` : packed, [ROWS, column], of a step by its number, 0 where the record begins. `voltage` : measured one,
    [column], likewise, in place of the battery's.
    """

    names: Sequence[str]
    samples: int
    targets: Callable[[int], Array]
    voltage: Callable[[int], Array] | None = None


def fly_fleet(fleet: Fleet, task: Task, seed: int, progress: Progress | None = None) -> FleetHistory:
    """Fly all columns at once.

    seed : of wakes, gusts, gyros and charge. progress : called with samples done and in all.
    """
    windy = any(any(one.air.wind) or one.air.gusts for one in fleet.craft)
    every, samples, entry = fleet.every, task.samples, round((WINDY_ENTRY if windy else ENTRY) / fleet.step)
    world = _World(fleet, task, seed, (samples - 1) * every + entry + 1)
    rows: list[dict[str, Array]] = []
    for step in range(-entry, (samples - 1) * every + 1):
        row = world.step(step)
        if step >= 0 and step % every == 0:
            rows.append(row)
            if progress is not None and (len(rows) % 25 == 0 or len(rows) == samples):
                progress(len(rows), samples)
    time = np.arange(samples, dtype=np.float64) * (fleet.step * every)
    return FleetHistory(time, **{name: np.stack([row[name] for row in rows]) for name in rows[0]})


class _World:
    """States of all vehicles, and what moves them."""

    def __init__(self, fleet: Fleet, task: Task, seed: int, steps: int) -> None:
        craft, columns, names = fleet.craft, len(fleet.craft), task.names
        self.fleet, self.task, self.dt, self.control = fleet, task, fleet.step, fleet.controller()
        self.mass = np.array([v.mass for v in craft])
        self.inertia = np.stack([v.inertia_matrix for v in craft], axis=-1)
        self.inverse: Array = np.stack([np.linalg.inv(v.inertia_matrix) for v in craft], axis=-1).astype(np.float64)
        self.gravity = np.array([v.gravity for v in craft])
        self.places = np.stack([np.asarray(v.places) for v in craft], axis=-1).swapaxes(0, 1)
        across = self.places[:, :, None] - self.places[:, None]
        self.spacing = (across * across).sum(0)
        self.spins = np.array([v.spins for v in craft], dtype=np.float64).T
        self.strength = np.array([v.lifts for v in craft]).T
        self.lean = np.stack([v.lean for v in craft], axis=-1)
        self.wake = craft[0].wake * craft[0].above
        felt = ("axial", "lift", "drag", "ground")
        self.air = {name: np.array([getattr(v.air, name) for v in craft]) for name in felt}
        flap = np.array([v.air.flap for v in craft])  # moments on the hub go by the velocity that drag feels
        self.air["drag"] = np.maximum(self.air["drag"], UNFELT * (flap > 0.0))
        self.flapping = flap / np.where(self.air["drag"] > 0.0, self.air["drag"], 1.0)
        self.drag_area = 0.5 * fleet.blades.density * np.array([v.air.drag_area for v in craft]).T
        self.wind = np.array([v.air.wind for v in craft]).T
        self.gusts = turbulence(craft, names, steps, self.dt, seed)
        self.unsteady, self.noise = (np.array([getattr(v, n) for v in craft]) for n in ("unsteady", "gyro"))
        self.streams = [np.random.default_rng([seed, zlib.crc32(f"{name}/wake".encode())]) for name in names]
        self.chance = np.empty((0, craft[0].count + 3, columns))
        charge = [np.random.default_rng([seed, zlib.crc32(f"{n}/charge".encode())]).uniform(0.0, 0.6) for n in names]
        self.used = np.array([share * v.battery.capacity for share, v in zip(charge, craft, strict=True)])
        self.place, self.euler = np.zeros((3, columns)), np.zeros((3, columns))
        self.velocity, self.rates = np.zeros((3, columns)), np.zeros((3, columns))
        self.speeds, self.induced = fleet.hover.speed.copy(), fleet.hover.induced.copy()
        self.current = fleet.drives.current(fleet.hover.curve * fleet.hover.ratio * self.speeds**2, self.speeds, 10.0)
        self.flutter, self.gyro = np.zeros_like(self.speeds), np.zeros((3, columns))
        self.swing = np.zeros((4, columns))
        self.late = _Late(np.array([v.drive.delay for v in craft]) / self.dt, self.speeds.shape)
        self.begun = 0

    def step(self, number: int) -> dict[str, Array]:
        """One step; what a record has at its beginning."""
        if not self.begun:
            self._begin(number)
        earth, pose = to_earth(self.euler), self._pose()
        self._chance()
        targets = Targets.unpack(self.task.targets(max(number, 0)))
        drives = self.fleet.drives
        commands = self.control.commands(targets, pose, self.rates + self.gyro, drives, self.dt)
        voltage = self._voltage(number)
        before = self.speeds
        self.speeds = drives.turned(before, drives.asked(self.late.after(commands), voltage), self.dt)
        air = self.wind if self.gusts is None else self.wind + self.gusts[self.begun - 1]
        force, moment, torque, spared = self._loads(earth, air, (self.speeds - before) / self.dt)
        specific, angular, swinging = self._accelerations(earth, air, force, moment)
        # commands and forces stay over the step: what is read in its middle is no half step behind them
        place, velocity, euler, rates = self._moved(earth, pose, specific, angular, 0.5 * self.dt)
        row = {
            "place": place,
            "velocity": velocity,
            "euler": euler,
            "rates": rates,
            "specific_force": specific,
            "angular": angular,
            "force": self.mass * specific,
            "moment": turned(self.inertia, angular) + cross(rates, turned(self.inertia, rates)),
            "speeds": self.speeds,
            "commands": commands,
            "voltage": voltage,
            "air": air + np.zeros_like(self.place),
            "spared": spared,
            "swing": self.swing[:2],
        }
        self.current = drives.current(torque, self.speeds, voltage)
        self.used = self.used + self.dt * self.current
        moved = self._moved(earth, pose, specific, angular, self.dt)
        self.place, self.velocity, self.euler, self.rates = moved
        if swinging.any():
            speed = self.swing[2:] + self.dt * swinging[2:]
            self.swing = np.concatenate([self.swing[:2] + self.dt * speed, speed])
        return row

    def _voltage(self, number: int) -> Array:
        """Of the battery, or as it was measured."""
        if self.task.voltage is not None:
            return self.task.voltage(max(number, 0))
        return self.fleet.drives.voltage(self.used, self.current)

    def _begin(self, number: int) -> None:
        """At rest where the first targets are."""
        first = Targets.unpack(self.task.targets(max(number, 0)))
        self.place, self.euler = first.place.copy(), np.stack([*np.zeros_like(first.tilt), first.heading])

    def _pose(self) -> Pose:
        trig = np.stack([np.cos(self.euler), np.sin(self.euler)])
        return Pose(self.place, self.velocity, self.euler, trig)

    def _chance(self) -> None:
        """Unsteady thrust and noise of the controller's gyros for this step."""
        at = self.begun % CHUNK
        if at == 0:
            shape = (CHUNK, self.chance.shape[1])
            self.chance = np.stack([stream.standard_normal(shape) for stream in self.streams], axis=-1)
        self.begun += 1
        white, fade = self.chance[at], np.exp(-self.dt / UNSTEADY)
        self.flutter = fade * self.flutter + self.unsteady * np.sqrt(1.0 - fade * fade) * white[:-3]
        self.gyro = 0.75 * self.gyro + 0.25 * self.noise * white[-3:]

    def _loads(self, earth: Array, air: Array, turning: Array) -> tuple[Array, Array, Array, Array]:
        """Force and moment on the body, body axes, torques of the shafts and what the ground takes of the inflow."""
        through = turned(earth.swapaxes(0, 1), self.velocity - air)
        at_rotors = through[:, None] + cross(self.rates[:, None], self.places)
        down = -self.air["axial"] * at_rotors[2]
        if self.wake.any():
            down = down + self.wake @ self.induced
        speed = np.sqrt(at_rotors[0] ** 2 + at_rotors[1] ** 2)
        spared: Array | float = 0.0
        if self.air["ground"].any():
            height = -(self.place[2] + (earth[2][:, None] * self.places).sum(0))
            ratio = speed / np.maximum(self.induced, 0.1)
            spared = self.air["ground"] * ground_share(height, self.spacing, self.fleet.blades.radius, ratio)
            spared = np.minimum(spared, 0.9)
        flow = Flow(down, self.air["lift"] * speed, self.air["drag"] * at_rotors[:2], spared)
        blades = self.fleet.blades
        self.induced = blades.inflow_step(self.speeds, self.induced, flow, self.strength, self.dt)
        loads = blades.loads(self.speeds, self.induced, flow, self.strength, self.spins)
        thrust = loads.thrust * (1.0 + self.flutter)
        each = np.concatenate([loads.across + self.lean * thrust, -thrust[None]])
        moment = cross(self.places, each).sum(1)
        moment[:2] += self.flapping * loads.hub.sum(1)
        inertia = self.fleet.drives.inertia
        moment[2] += (self.spins * (loads.torque + inertia * turning)).sum(0)
        spin = -(self.spins * inertia * self.speeds).sum(0)  # angular momentum of the rotors along z
        moment[0] -= self.rates[1] * spin
        moment[1] += self.rates[0] * spin
        force = each.sum(1) - self.drag_area * np.sqrt(dot(through, through)) * through
        return force, moment, loads.torque, np.mean(spared + np.zeros_like(self.speeds), axis=0)

    def _accelerations(self, earth: Array, air: Array, force: Array, moment: Array) -> tuple[Array, Array, Array]:
        """Specific force, m/s^2, and angular acceleration, rad/s^2, of the body, and rates of the loads' swing."""
        moment = moment - cross(self.rates, turned(self.inertia, self.rates))
        specific, angular = force / self.mass, turned(self.inverse, moment)
        swinging = np.zeros_like(self.swing)
        for load, part in self._laden():
            around = Surroundings(earth[:, :, part], float(self.fleet.blades.density[part][0]), self.gravity[part][0])
            through = turned(around.earth.swapaxes(0, 1), self.velocity[:, part] - (air + 0.0 * self.place)[:, part])
            pull = cable_pull(load, self.swing[:, part], through, self.rates[:, part], around)
            inverse, mass = self.inverse[:, :, part], self.mass[part]
            size = dot(pull.force, pull.direction)
            f = specific[:, part] + pull.force / mass
            alpha = angular[:, part] + turned(inverse, pull.turning) * size
            # the cable's pull on what is accelerated: one row and column of the mass matrix more
            lightness = turned(inverse, pull.turning)
            yielding = 1.0 / mass + dot(pull.turning, lightness)
            back = load.mass * (dot(pull.direction, f) + dot(pull.turning, alpha)) / (1.0 + load.mass * yielding)
            f, alpha = f - pull.direction / mass * back, alpha - lightness * back
            specific[:, part], angular[:, part] = f, alpha
            swinging[:, part] = swing_rates(load, pull, f, alpha, around.earth)
        return specific, angular, swinging

    def _laden(self) -> Iterator[tuple[SlungLoad, slice]]:
        """Loads with the columns that they hang below: those of one vehicle stand side by side."""
        first = 0
        for load, some in groupby(v.load for v in self.fleet.craft):
            count = len(list(some))
            if load is not None:
                yield load, slice(first, first + count)
            first += count

    def _moved(self, earth: Array, pose: Pose, specific: Array, angular: Array, dt: float) -> tuple[Array, ...]:
        """Place, velocity, Euler angles and body rates a time of dt later under constant forces."""
        rates = self.rates + dt * angular
        p, q, r = 0.5 * (self.rates + rates)
        (cf, ct, _), (sf, st, _) = pose.trig
        yaw = (sf * q + cf * r) / ct
        euler = self.euler + dt * np.stack([p + st * yaw, cf * q - sf * r, yaw])
        acceleration = turned(earth, specific + (0.5 * dt) * cross(self.rates, specific))
        acceleration[2] += self.gravity
        velocity = self.velocity + dt * acceleration
        return self.place + (0.5 * dt) * (self.velocity + velocity), velocity, euler, rates


class _Late:
    """Commands of the last steps, to be read a delay later, between steps in a line."""

    def __init__(self, delay: Array, shape: tuple[int, ...]) -> None:
        """`delay` in steps, [column]; `shape` : of the commands."""
        self.back, part = np.divmod(delay, 1.0)
        self.part, self.back = part, self.back.astype(int)
        self.memory = np.zeros((int(self.back.max()) + 2, *shape))
        self.columns, self.count = np.arange(len(delay)), 0

    def after(self, commands: Array) -> Array:
        """What arrives at the drives now that these commands, [rotor, column], are sent."""
        size = len(self.memory)
        if self.count == 0:
            self.memory[:] = commands
        self.memory[self.count % size] = commands
        at = self.count - self.back
        self.count += 1
        if size == 2 and not self.part.any():
            return commands
        near, far = (self.memory[(at - k) % size, :, self.columns].T for k in (0, 1))
        return near + self.part * (far - near)
