"""Whole helicopters, main rotors in multi-blade coordinates: a batch of different aircraft, each in several flights.

The blades are rigid rods on hinges, as in `rotor`, but their flap and lag are the first harmonics in azimuth, and loads
are averaged over azimuths that stand still. Nothing repeats with the blades' passage, so one step per sample suffices,
trim is a point and a linear model is a difference. Arrays are [component, aircraft, flight]; numbers of the aircraft
are [aircraft, 1]. Rotors turn counter-clockwise; positions are from the point whose velocity is u v w.

With A + s B the acceleration of a blade at the distance s from its hinge, both affine in the unknown accelerations z of
body, shaft, flap and lag, Kane's equations read M z = h: M is taken once at trim, h at every instant.

Source: Johnson, Helicopter Theory, chapters 8 and 9 (multi-blade coordinates, flap and lag about offset hinges); Kane
and Levinson, Dynamics: Theory and Applications, chapter 6.
"""

from dataclasses import dataclass

import numpy as np

from rotorid_torch.simulation.helicopter.inflow import inflow_rates
from rotorid_torch.simulation.helicopter.rotor import turn_back
from rotorid_torch.simulation.multiblade.airframe import airframe_loads
from rotorid_torch.simulation.multiblade.craft import (
    BODY,
    FLAP,
    FLAP_RATE,
    INFLOW,
    LAG,
    LAG_RATE,
    RATES,
    SPEED,
    SPEED_ERROR,
    TAIL_INFLOW,
    TORQUE,
    Craft,
    Response,
    Setting,
    to_body,
    to_shaft,
)
from rotorid_torch.simulation.rigid import Array, body_rates, cross, dot

UNKNOWNS = 13
"""Accelerations: specific force (3), angular (3), of the shaft, of a0 a1 b1, of the three lag coordinates."""
AZIMUTHS = 6  # products of the third harmonic are still averaged exactly
STATIONS = 4  # points of Gauss and Legendre along a blade

_ANGLES = 2.0 * np.pi / AZIMUTHS * np.arange(AZIMUTHS, dtype=np.float64)
COSINE, SINE = np.cos(_ANGLES)[:, None, None], np.sin(_ANGLES)[:, None, None]
FLAP_SHAPES = np.stack([np.ones_like(COSINE), -COSINE, -SINE])
LAG_SHAPES = np.stack([np.ones_like(COSINE), COSINE, SINE])
"""[3, azimuth, 1, 1]: blade flap and lag by their coordinates."""


def blade_elements(craft: Craft) -> tuple[Array, tuple[Array, Array]]:
    """Stations and weights of `Setting` (Gauss-Legendre from cutout to lifting tip)."""
    nodes, weights = np.polynomial.legendre.leggauss(STATIONS)
    half = 0.5 * (craft.tip_loss - craft.root_cutout) * craft.radius
    middle = 0.5 * (craft.tip_loss + craft.root_cutout) * craft.radius - craft.hinge_offset
    stations = (middle + half * nodes[:, None, None])[:, None]
    pressure = (0.5 * craft.density * craft.chord * half * weights[:, None, None])[:, None]
    return stations, (pressure, pressure * stations)


@dataclass(frozen=True)
class Blades:
    """Geometry and velocities of the blades at all azimuths, (radial, tangential, up), [3, azimuth, aircraft, flight].

    `swing` is d(d)/dt in inertial space; `quiet_swing` its rate without the unknown accelerations.
    """

    d: Array
    n: Array
    t: Array
    flap: Array
    lag: Array
    lag_rate: Array
    swing: Array
    quiet_swing: Array


def blade_motion(x: Array, spin: Array, speed: Array) -> Blades:
    """Blades from the states; `spin` [3, azimuth, aircraft, flight] of the turning frame, `speed` of the rotor, 1/s."""
    a0, a1, b1 = x[FLAP]
    z0, zc, zs = x[LAG]
    flap, lag = a0 - a1 * COSINE - b1 * SINE, z0 + zc * COSINE + zs * SINE
    da0, da1, db1 = x[FLAP_RATE]
    dz0, dzc, dzs = x[LAG_RATE]
    flap_rate = da0 + (speed * a1 - db1) * SINE - (da1 + speed * b1) * COSINE
    lag_rate = dz0 + (dzc + speed * zs) * COSINE + (dzs - speed * zc) * SINE
    square = speed * speed
    flap_bend = (square * a1 - 2.0 * speed * db1) * COSINE + (2.0 * speed * da1 + square * b1) * SINE
    lag_bend = (2.0 * speed * dzs - square * zc) * COSINE - (2.0 * speed * dzc + square * zs) * SINE
    cb, sb = 1.0 - 0.5 * flap * flap, flap * (1.0 - flap * flap / 6.0)
    cz, sz = 1.0 - 0.5 * lag * lag, lag * (1.0 - lag * lag / 6.0)
    d = np.stack([cb * cz, -cb * sz, sb])
    n = np.stack([-sb * cz, sb * sz, cb])
    t = np.stack([-sz, -cz, np.zeros_like(sz)])
    turned = flap_rate * n + (lag_rate * cb) * t
    swing = cross(spin, d) + turned
    quiet = cross(spin, swing + turned)
    # The up axis turns with the body: speed (omega x up) x d.
    lean = spin[0] * d[0] + spin[1] * d[1]
    quiet[0] -= speed * spin[0] * d[2]
    quiet[1] -= speed * spin[1] * d[2]
    quiet[2] += speed * lean
    quiet += (flap_bend + cb * sb * lag_rate * lag_rate) * n + (cb * lag_bend - 2.0 * sb * flap_rate * lag_rate) * t
    quiet -= (flap_rate * flap_rate + cb * cb * lag_rate * lag_rate) * d
    return Blades(d, n, t, flap, lag, lag_rate, swing, quiet)


def air_loads(craft: Craft, setting: Setting, blades: Blades, hinge: Array, x: Array, u: Array) -> tuple[Array, ...]:
    """Normal and lagging force, N, and their moments about the hinge, N m, [azimuth, aircraft, flight].

    Attached flow at small angles: lift slope x chord x (pitch x ahead - up) x ahead, and profile drag.

    Source: Leishman, Principles of Helicopter Aerodynamics, chapter 3 (blade element analysis).
    """
    speed, s, lifted = x[SPEED], setting.stations, blades.n[2]
    gradient = x[INFLOW][1] * COSINE + x[INFLOW][2] * SINE
    up0 = dot(blades.n, hinge) + lifted * speed * (craft.radius * x[INFLOW][0] + craft.hinge_offset * gradient)
    up1 = dot(blades.n, blades.swing) + lifted * (speed * gradient)
    ahead0, ahead1 = -(blades.t[0] * hinge[0] + blades.t[1] * hinge[1]), -dot(blades.t, blades.swing)
    up, ahead = up0 + s * up1, ahead0 + s * ahead1
    c, k = np.cos(craft.swash_phase), np.sin(craft.swash_phase)
    lon, lat, col = u[0], u[1], u[2]
    pitch = col + (lat * c + lon * k) * COSINE + (lon * c - lat * k) * SINE - craft.delta3 * blades.flap
    pitch = pitch + craft.twist * ((s + craft.hinge_offset) / craft.radius)
    effective = pitch * ahead - up
    normal = craft.lift_slope * (effective * ahead)
    lagging = effective * (craft.lift_slope * up + craft.drag_rise * effective) + craft.drag * (ahead * ahead)
    force, moment = setting.weights
    return (force * normal).sum(0), (force * lagging).sum(0), (moment * normal).sum(0), (moment * lagging).sum(0)


def rotor_loads(craft: Craft, setting: Setting, x: Array, u: Array, at_hub: Array) -> tuple[Array, Array]:
    """Generalised forces [13, aircraft, flight] of all blades, in the order of the unknowns, and the inflow's loading.

    `at_hub` [3, aircraft, flight]: velocity of the hub, shaft frame. The third component of the moment is about up.
    """
    offset, speed = craft.hinge_offset, x[SPEED]
    omega = to_shaft(craft.tilt, x[RATES])
    spin = turn(omega)
    spin[2] += speed
    blades = blade_motion(x, spin, speed)
    hinge = turn(at_hub)
    hinge[1] += offset * spin[2]
    hinge[2] -= offset * spin[1]
    fn, ft, mn, mt = air_loads(craft, setting, blades, hinge, x, u)
    arm = to_shaft(craft.tilt, craft.hub)
    quiet = turn(cross(omega, -cross(arm, omega)))
    quiet[0] -= offset * (spin[1] * spin[1] + spin[2] * spin[2])
    quiet[1] += offset * (spin[0] * spin[1])
    quiet[2] += offset * (spin[0] * (spin[2] + speed))
    root = fn * blades.n + ft * blades.t - craft.blade_mass * quiet - craft.first_moment * blades.quiet_swing
    twisting = mn * blades.n + mt * blades.t - craft.first_moment * quiet - craft.flap_inertia * blades.quiet_swing
    share = craft.blades / AZIMUTHS
    moment = cross(blades.d, twisting)
    moment[1] -= offset * root[2]
    moment[2] += offset * root[1]
    out = np.zeros((UNKNOWNS, *speed.shape))
    force = turn_back(root, COSINE, SINE).sum(1)
    out[:3] = to_body(craft.tilt, force)
    about = turn_back(moment, COSINE, SINE).sum(1)
    out[3:6] = to_body(craft.tilt, about + cross(arm, force))
    out[6] = about[2]
    flapping = dot(blades.n, twisting) - craft.flap_spring * blades.flap
    lagging = (1.0 - 0.5 * blades.flap * blades.flap) * dot(blades.t, twisting)
    lagging -= craft.lag_spring * blades.lag + craft.lag_damper * blades.lag_rate
    out[7:10] = (FLAP_SHAPES * flapping).sum(1)
    out[10:13] = (LAG_SHAPES * lagging).sum(1)
    return share * out, share * _loading(craft, blades, fn, mn, speed)


def turn(vector: Array) -> Array:
    """(aft, right, up), [3, aircraft, flight] to (radial, tangential, up), [3, azimuth, aircraft, flight]."""
    out = np.empty((3, AZIMUTHS, *vector.shape[1:]))
    out[0] = COSINE * vector[0] + SINE * vector[1]
    out[1] = COSINE * vector[1] - SINE * vector[0]
    out[2] = vector[2]
    return out


def _loading(craft: Craft, blades: Blades, force: Array, moment: Array, speed: Array) -> Array:
    """Thrust coefficient and its first moments along (aft, right), [3, aircraft, flight]."""
    lifted = blades.n[2] * (craft.hinge_offset * force + moment)
    loads = np.stack([(blades.n[2] * force).sum(0) * craft.radius, (COSINE * lifted).sum(0), (SINE * lifted).sum(0)])
    tip_speed = speed * craft.radius
    return loads / (craft.density * np.pi * craft.radius**3 * tip_speed * tip_speed)


def respond(craft: Craft, setting: Setting, x: Array, u: Array, gust: Array | float = 0.0) -> tuple[Array, Response]:
    """Rates of all states, and what the accelerometers feel.

    x : [31, aircraft, flight].
    u : [4, aircraft, flight] lon, lat, col, ped at the blades, rad.
    gust : [3, aircraft, flight] velocity of the air, body axes, m/s.
    """
    omega, speed, ground = x[RATES], x[SPEED], x
    x = x.copy()
    x[BODY] -= gust
    at_hub = to_shaft(craft.tilt, x[BODY] - cross(craft.hub, omega))
    loads, loading = rotor_loads(craft, setting, x, u, at_hub)
    dx = np.zeros_like(x)
    over_tip = at_hub / (speed * craft.radius)
    driven = loading * craft.inflow_gain[[0, 1, 1]]
    rates, sweep = inflow_rates(x[INFLOW], driven, over_tip, speed)
    dx[INFLOW] = rates * craft.inflow_speed[[0, 1, 1]]
    force, moment, dx[TAIL_INFLOW] = airframe_loads(craft, x, u[3], sweep)
    loads[:3] += force
    loads[3:6] += moment
    loads[:6] -= centrifugal(setting, omega)
    torque = loads[6].copy()
    if not craft.held:
        loads[6] += x[TORQUE]
    z = (setting.inverse @ loads.swapaxes(0, 1)).swapaxes(0, 1)
    dx[:12] = body_rates(ground[:12], z[:3], z[3:6], craft.gravity)
    slack = (setting.relax @ loads[7:10].swapaxes(0, 1)).swapaxes(0, 1)
    dx[FLAP] = x[FLAP_RATE] + slack
    dx[FLAP_RATE], dx[LAG], dx[LAG_RATE] = z[7:10], x[LAG_RATE], z[10:13]
    if not craft.held:
        _drive(craft, x, z[6], dx)
    return dx, Response(z[:3], z[3:6], loads[7:10], -torque)


def _drive(craft: Craft, x: Array, speed_rate: Array, dx: Array) -> None:
    """Rates of rotor speed, engine torque and the governor's integral.

    Source: Hilbert, NASA TM-85890, table 3 (proportional, integral and rate governor, engine lag).
    """
    error = craft.speed - x[SPEED]
    dx[SPEED], dx[SPEED_ERROR] = speed_rate, error
    wanted = craft.governor_proportional * error + craft.governor_integral * x[SPEED_ERROR]
    dx[TORQUE] = (wanted - craft.governor_derivative * speed_rate - x[TORQUE]) / craft.governor_lag


def body_inertia(craft: Craft) -> tuple[Array, Array, Array]:
    """Mass [aircraft, 1], first moment [3, aircraft, 1] and inertia [3, 3, aircraft, 1] beside the moving blades.

    Blades that are counted in the declaration sit at the hub there; where flapping is quasi-steady they stay with the
    body, as in simulators of that kind.
    """
    steady = craft.steady_flap[:, None]
    sign = np.where(steady, 0.0, -1.0) if craft.with_blades else np.where(steady, 1.0, 0.0)
    mass = sign * craft.blades * craft.blade_mass
    hub = craft.hub
    point = dot(hub, hub) * np.eye(3)[:, :, None, None] - hub[:, None] * hub[None]
    return craft.mass + mass, mass * hub, craft.inertia + mass * point


def centrifugal(setting: Setting, omega: Array) -> Array:
    """Force and moment that it takes to turn the body at a steady rate, [6, aircraft, flight]."""
    first, inertia = setting.body
    momentum = (inertia * omega[None]).sum(1)
    return np.concatenate([cross(omega, -cross(first, omega)), cross(omega, momentum)])
