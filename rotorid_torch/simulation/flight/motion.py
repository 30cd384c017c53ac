"""A helicopter in motion: rates of its states from rotor, tails, fuselage, cable and the body's motion.

Arrays are [component, flight] (blades: [component, blade, flight]); all flights are one batch.
"""

from dataclasses import dataclass

import numpy as np

from rotorid_torch.simulation.helicopter.aircraft import (
    AZIMUTH,
    BODY,
    CONTROLS,
    EULER,
    INFLOW,
    PLACE,
    RATES,
    SPEED,
    SPEED_ERROR,
    TAIL_INFLOW,
    TORQUE,
    Aircraft,
)
from rotorid_torch.simulation.helicopter.airframe import downwash, fuselage_loads, surface_force
from rotorid_torch.simulation.helicopter.control_path import follow
from rotorid_torch.simulation.helicopter.inflow import curvature_rates, ground_factor, inflow_rates
from rotorid_torch.simulation.helicopter.rotor import (
    BladeMotion,
    RootLoads,
    air_loads,
    blade_motion,
    blade_rates,
    root_loads,
    tilting,
)
from rotorid_torch.simulation.helicopter.slung_load import Pull, Surroundings, cable_pull, swing_rates
from rotorid_torch.simulation.helicopter.tail import tail_rotor
from rotorid_torch.simulation.rigid import Array, body_rates, cross, dot, to_earth, turned


@dataclass(frozen=True)
class Motion:
    """What the accelerations and loads of one instant are, body axes, [3, flight].

    `specific_force`: acceleration of the centre of gravity minus gravity, m/s^2; `angular`: rad/s^2; `force` (N) and
    `moment` (N m) act on the body from outside, gravity not among them, about its centre of gravity; [flight]:
    `shaft_torque` that the engine gives, N m, and `speed_rate` of the rotor, rad/s^2.
    """

    specific_force: Array
    angular: Array
    force: Array
    moment: Array
    shaft_torque: Array
    speed_rate: Array


@dataclass(frozen=True)
class Outside:
    """What comes to the aircraft from outside its states at one instant, or from its past.

    `gust`: velocity of the air beyond the steady wind, body axes, m/s, [3, flight]; `delayed`: recorded controls and
    their rates, [4, flight] each, as they leave the control path's delay.
    """

    gust: Array | None = None
    delayed: tuple[Array, Array] | None = None


STILL = Outside()


def rates(aircraft: Aircraft, x: Array, command: Array, outside: Outside = STILL) -> tuple[Array, Motion]:
    """Rates of all states, and the motion that goes with them.

    x : [states, flight].
    command : [4, flight] commanded lon, lat, col, ped, rad; the actuators follow.
    outside : gusts and delayed controls; without it the air carries no gusts and no control is late.
    """
    rotor, density, flights = aircraft.rotor, aircraft.air_density, x.shape[1]
    omega, speed = x[RATES], x[SPEED]
    dx = np.zeros_like(x)
    low, high = aircraft.limit_rows
    dx[CONTROLS] = (np.clip(command, low, high) - x[CONTROLS]) / aircraft.actuator_lag
    angles, dx[aircraft.settled_rows :] = blade_angles(aircraft, x, dx, outside)
    local = x[BODY] - (aircraft.levers @ omega).reshape(5, 3, flights)
    centripetal = cross(omega, local[0] - x[BODY])
    air_motion = moving_air(aircraft, x, outside)
    if air_motion is not None:
        local = local - air_motion
    at_hub = rotor.to_shaft @ local[0]
    blades = x[aircraft.blade_rows].reshape(4, rotor.blades, flights)
    motion = blade_motion(rotor, blades, rotor.to_shaft @ omega, x[AZIMUTH], speed)
    air = air_loads(rotor, motion, at_hub, _felt_inflow(aircraft, x), angles, density)
    over_tip = at_hub / (speed * rotor.radius)
    dx[INFLOW], sweep = _inflow(aircraft, x, air.loading, over_tip, motion, dx)
    force, moment, dx[TAIL_INFLOW] = _airframe_loads(aircraft, x, local, sweep, angles[3])
    root = root_loads(rotor, motion, air, rotor.to_shaft @ centripetal)
    pull = _pull(aircraft, x, air_motion)
    balance = _solve(aircraft, x, root, force, moment, pull)
    dx[:12] = body_rates(x[:12], balance.specific_force, balance.angular, aircraft.gravity)
    _drive(aircraft, x, balance, dx)
    if aircraft.load is not None and pull is not None:
        earth = to_earth(x[EULER])
        dx[aircraft.swing_rows] = swing_rates(aircraft.load, pull, balance.specific_force, balance.angular, earth)
    linear = rotor.to_shaft @ (balance.specific_force - aircraft.levers[:3] @ balance.angular)
    angular = rotor.to_shaft @ balance.angular
    angular[2] += balance.speed_rate
    turning = blade_rates(rotor, motion, air, root, linear, angular)
    dx[aircraft.blade_rows] = turning.reshape(-1, flights)
    return dx, balance


def blade_angles(aircraft: Aircraft, x: Array, dx: Array, outside: Outside = STILL) -> tuple[Array, Array]:
    """Angles lon lat col ped at the blades, rad, [4, flight], and the rates of the control path's states.

    `dx`: rates of the states, of which those of the controls count.
    """
    if aircraft.path is None:
        return x[CONTROLS], x[aircraft.settled_rows :]
    value, rate = outside.delayed or (x[CONTROLS], dx[CONTROLS])
    return follow(aircraft.path, x[aircraft.settled_rows :], value, rate)


def moving_air(aircraft: Aircraft, x: Array, outside: Outside = STILL) -> Array | None:
    """Velocity of the air over ground, body axes, m/s, [3, flight]; None where it is at rest."""
    if aircraft.wind is None:
        return outside.gust
    wind = turned(to_earth(x[EULER]).swapaxes(0, 1), np.asarray(aircraft.wind)[:, None])
    return wind if outside.gust is None else wind + outside.gust


def ground_part(aircraft: Aircraft, x: Array) -> Array:
    """Part of the induced velocity that the ground takes away, [flight]."""
    rotor = aircraft.rotor
    ahead, induced = np.hypot(x[0], x[1]), x[INFLOW.start] * x[SPEED] * rotor.radius
    return ground_factor(aircraft.wake.ground, rotor.radius, x[PLACE][2] - rotor.hub[2], ahead, induced)


def _felt_inflow(aircraft: Aircraft, x: Array) -> Array:
    """Inflow as the blades meet it, (3, flight): near the ground less than the wake far from it would bring."""
    if not aircraft.wake.ground:
        return x[INFLOW]
    felt = x[INFLOW].copy()
    felt[0] *= 1.0 - ground_part(aircraft, x)
    return felt


def _inflow(
    aircraft: Aircraft, x: Array, loading: Array, over_tip: Array, motion: BladeMotion, dx: Array
) -> tuple[Array, Array]:
    """Rates of the inflow and the wake's sweep; the rates of its curvature, where it has one, go into `dx`."""
    wake, speed, inflow = aircraft.wake, x[SPEED], x[INFLOW]
    swept = np.stack([over_tip[0] * wake.translation, over_tip[1] * wake.translation, over_tip[2]])
    if not wake.distortion:
        return inflow_rates(inflow, loading, swept, speed, wake)
    curvature, shaft = x[aircraft.curvature_rows], aircraft.rotor.to_shaft @ x[RATES]
    tilt = tilting(motion, shaft)
    dx[aircraft.curvature_rows] = curvature_rates(curvature, tilt, inflow[0], swept[:2], swept[2], speed)
    return inflow_rates(inflow, loading, swept, speed, wake, curvature)


def _pull(aircraft: Aircraft, x: Array, air_motion: Array | None) -> Pull | None:
    """The cable's pull, where a load hangs on one."""
    if aircraft.load is None:
        return None
    through = x[BODY] if air_motion is None else x[BODY] - air_motion
    surroundings = Surroundings(to_earth(x[EULER]), aircraft.air_density, aircraft.gravity)
    return cable_pull(aircraft.load, x[aircraft.swing_rows], through, x[RATES], surroundings)


def _airframe_loads(
    aircraft: Aircraft, x: Array, local: Array, sweep: Array, pedal: Array
) -> tuple[Array, Array, Array]:
    """Force and moment of all but the main rotor about the centre of gravity, and the rate of the tail rotor's inflow.

    `local`: [5, 3, flight] velocities at hub, tail rotor, fuselage, fin, tailplane; `pedal`: tail rotor's collective.
    """
    density, radius = aircraft.air_density, aircraft.rotor.radius
    mean = x[INFLOW][0] * x[SPEED] * radius
    wash = downwash(radius, aircraft.washed_places, sweep, mean)
    if aircraft.tail.wake_factor or aircraft.swirl:
        local = local.copy()
        at_tail = downwash(radius, aircraft.tail_place, sweep, mean)[0]
        local[1, 2] -= aircraft.tail.wake_factor * at_tail
        local[1, 1] -= aircraft.swirl * at_tail
        local[3, 1] -= aircraft.swirl * wash[1]
    tail, rate = tail_rotor(aircraft.tail, local[1], x[TAIL_INFLOW], pedal, x[SPEED], density)
    body, turning = fuselage_loads(aircraft.fuselage, local[2], wash[0], density)
    fin = surface_force(aircraft.fin, local[3], wash[1], density)
    plane = surface_force(aircraft.tailplane, local[4], wash[2], density)
    moment = aircraft.loads_to_moment @ np.concatenate([tail, body, fin, plane])
    if aircraft.quadratic_damping is not None:
        omega = x[RATES]
        turning = turning - np.asarray(aircraft.quadratic_damping)[:, None] * omega * np.abs(omega)
    return tail + body + fin + plane, moment + turning, rate


def _solve(
    aircraft: Aircraft, x: Array, root: RootLoads, force: Array, moment: Array, pull: Pull | None = None
) -> Motion:
    """Newton and Euler for the body with all blades hanging on it, and the shaft: six unknowns, seven if it is free."""
    omega, up, flights = x[RATES], aircraft.rotor.to_shaft[2][:, None], x.shape[1]
    arm = root.arm + np.asarray(aircraft.rotor.hub)[:, None, None]
    gyroscopic = cross(omega, aircraft.inertia_matrix @ omega)
    right_side = np.empty((7, flights))
    right_side[:3] = force + root.force.sum(1)
    right_side[3:6] = moment + (cross(arm, root.force) + root.moment).sum(1) - gyroscopic
    right_side[6] = ((cross(root.arm, root.force) + root.moment).sum(1) * up).sum(0)
    columns = _jacobian(arm, root, up)
    reaction = columns.swapaxes(1, 2) @ columns
    if aircraft.load is not None and pull is not None:
        hook = np.asarray(aircraft.load.hook)[:, None]
        right_side[:3] += pull.force
        right_side[3:6] += cross(hook, pull.force)
        row = np.concatenate([pull.direction, pull.turning, np.zeros((1, flights))]).T
        reaction = reaction + aircraft.load.mass * row[:, :, None] * row[:, None, :]
    total = aircraft.own_matrix + reaction
    size = 6 if aircraft.governor.held else 7
    driven = right_side.copy()
    driven[6] += x[TORQUE]
    solution = np.zeros((flights, 7, 1))
    solution[:, :size] = np.linalg.solve(total[:, :size, :size], driven[:size].T[:, :, None])
    answer, torque = (reaction @ solution)[:, :6, 0].T, (total[:, 6:] @ solution)[:, 0, 0] - right_side[6]
    solved = solution[:, :, 0].T
    about = right_side[3:6] + gyroscopic - answer[3:]
    return Motion(solved[:3], solved[3:6], right_side[:3] - answer[:3], about, torque, solved[6])


def _jacobian(arm: Array, root: RootLoads, up: Array) -> Array:
    """Square root of the blades' reaction matrix: rows of all blades, columns of the unknown accelerations.

    The reaction of a blade to the acceleration a = J y of its hinge is -J' (light 1 + heavy d d') J y.
    """
    blades, flights = arm.shape[1:]
    rows = np.zeros((flights, blades, 4, 7))
    light, heavy = np.sqrt(root.light), np.sqrt(root.heavy)
    x, y, z = light * arm.transpose(0, 2, 1)
    rows[:, :, 0, 0] = rows[:, :, 1, 1] = rows[:, :, 2, 2] = light
    rows[:, :, 0, 4], rows[:, :, 0, 5] = z, -y
    rows[:, :, 1, 3], rows[:, :, 1, 5] = -z, x
    rows[:, :, 2, 3], rows[:, :, 2, 4] = y, -x
    swing = cross(up[:, :, None], root.arm)
    rows[:, :, :3, 6] = light * swing.transpose(2, 1, 0)
    rows[:, :, 3, :3] = heavy * root.d.transpose(2, 1, 0)
    rows[:, :, 3, 3:6] = heavy * cross(arm, root.d).transpose(2, 1, 0)
    rows[:, :, 3, 6] = heavy * dot(swing, root.d).T
    return rows.reshape(flights, 4 * blades, 7)


def _drive(aircraft: Aircraft, x: Array, balance: Motion, dx: Array) -> None:
    """Rates of azimuth, rotor speed, engine torque and the governor's integral."""
    governor = aircraft.governor
    dx[AZIMUTH] = x[SPEED]
    if governor.held:
        return
    error = aircraft.rotor.speed - x[SPEED]
    dx[SPEED], dx[SPEED_ERROR] = balance.speed_rate, error
    wanted = governor.proportional * error + governor.integral * x[SPEED_ERROR] - governor.derivative * dx[SPEED]
    dx[TORQUE] = (wanted - x[TORQUE]) / governor.lag
