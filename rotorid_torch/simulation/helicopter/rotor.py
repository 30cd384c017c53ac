"""Main rotor: blades with flap and lead-lag about an offset hinge, blade elements, loads on the hub.

Frames. The shaft frame has the axes (aft, right, up) and does not turn; up is the shaft. A blade's frame (radial,
tangential, up) turns with the rotor; azimuth psi is 0 aft and grows counter-clockwise seen from above. A blade is a
thin rod with mass m, first moment S and inertia I about its hinge. Its direction is d(beta, zeta), flap beta up, lag
zeta against the rotation; (d, n, t) is right-handed, n = d(d)/d(beta), t the direction in which it lags.

Because the acceleration along a rod is affine, A + s B, Newton and Euler for each blade close without further unknowns:
n and t of S(A - g) + I B equal the moments of air, spring and damper, the root force follows, and the hinge hands the
hub the moments of spring and damper alone. Rows: arrays are [component, blade, flight].

Source: Johnson, Helicopter Theory, chapter 9 (flap and lag about offset hinges); derivation as described above.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotorid_torch.simulation.helicopter.section import Section
from rotorid_torch.simulation.rigid import Array, dot

LOCK_SLOPE = 5.73  # 1/rad: the lift slope that tables of Lock numbers customarily assume


@dataclass(frozen=True)
class Rotor:
    """Main rotor, all in SI.

    `swash_phase` turns the swashplate: a blade's pitch is col + lat cos(psi + swash_phase) + lon sin(psi + swash_phase)
    + twist. `hub` is the position from the centre of gravity of the body, body axes; the shaft leans forward by `tilt`.
    """

    blades: int
    radius: float
    chord: float
    speed: float
    hinge_offset: float
    hub: tuple[float, float, float]
    tilt: float
    swash_phase: float
    twist: float
    root_cutout: float
    tip_loss: float
    section: Section
    blade_mass: float
    first_moment: float
    flap_inertia: float
    flap_spring: float
    lag_spring: float
    lag_damper: float
    elements: int = 8

    @cached_property
    def to_shaft(self) -> Array:
        """Matrix from body axes to (aft, right, up)."""
        c, s = np.cos(self.tilt), np.sin(self.tilt)
        return np.array([[-c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, -c]])

    @cached_property
    def spacing(self) -> Array:
        """Azimuth of each blade behind the first, (blades, 1)."""
        return (2.0 * np.pi / self.blades) * np.arange(self.blades, dtype=np.float64)[:, None]

    @cached_property
    def stations(self) -> tuple[Array, Array]:
        """Distance of the elements from the hinge and their weights (Gauss-Legendre from cutout to lifting tip), m."""
        nodes, weights = np.polynomial.legendre.leggauss(self.elements)
        inner, outer = self.root_cutout * self.radius, self.tip_loss * self.radius
        radii = 0.5 * (outer + inner) + 0.5 * (outer - inner) * nodes
        return radii - self.hinge_offset, 0.5 * (outer - inner) * weights

    @cached_property
    def moments(self) -> Array:
        """[2, elements]: integrates a load per metre to force and to moment about the hinge."""
        stations, weights = self.stations
        return np.stack([weights, weights * stations])

    @cached_property
    def twist_rows(self) -> Array:
        """Twist at the elements, [elements, 1, 1] rad."""
        return self.twist * ((self.stations[0] + self.hinge_offset) / self.radius)[:, None, None]

    @property
    def disc(self) -> float:
        """Disc area, m^2."""
        return np.pi * self.radius**2


@dataclass(frozen=True)
class BladeMotion:
    """Geometry and velocities of all blades at one instant, blade frame, [component, blade, flight]."""

    speed: Array  # [flight] of the rotor, rad/s
    cosine: Array  # cos and sin of the azimuth
    sine: Array
    d: Array
    n: Array
    t: Array
    flap: Array
    lag: Array
    flap_rate: Array
    lag_rate: Array
    spin: Array  # angular velocity of the hub, (radial, tangential, up)
    spin_dnt: tuple[Array, Array, Array]  # the same along d, n, t
    normal_rate: Array  # d(d)/dt in inertial space along n, and along t
    lagging_rate: Array


def turn(vector: Array, cosine: Array, sine: Array) -> Array:
    """(aft, right, up), [3, flight] to each blade's (radial, tangential, up), [3, blade, flight]."""
    out = np.empty((3, *cosine.shape))
    out[0] = cosine * vector[0] + sine * vector[1]
    out[1] = cosine * vector[1] - sine * vector[0]
    out[2] = vector[2]
    return out


def turn_back(vector: Array, cosine: Array, sine: Array) -> Array:
    """Each blade's (radial, tangential, up) to (aft, right, up), [3, blade, flight]."""
    out = np.empty_like(vector)
    out[0] = cosine * vector[0] - sine * vector[1]
    out[1] = sine * vector[0] + cosine * vector[1]
    out[2] = vector[2]
    return out


def blade_motion(rotor: Rotor, blades: Array, rates: Array, azimuth: Array, speed: Array) -> BladeMotion:
    """Geometry and velocities of the blades.

    blades : [4, blade, flight] flap, flap rate, lag, lag rate.
    rates : [3, flight] angular velocity of the body, shaft frame.
    azimuth, speed : [flight] of the first blade, rad; of the rotor, rad/s.
    """
    flap, flap_rate, lag, lag_rate = blades
    angle = azimuth + rotor.spacing
    cosine, sine = np.cos(angle), np.sin(angle)
    cb, sb, cz, sz = np.cos(flap), np.sin(flap), np.cos(lag), np.sin(lag)
    d, n, t = np.empty((3, *flap.shape)), np.empty((3, *flap.shape)), np.zeros((3, *flap.shape))
    d[0], d[1], d[2] = cb * cz, -cb * sz, sb
    n[0], n[1], n[2] = -sb * cz, sb * sz, cb
    t[0], t[1] = -sz, -cz
    spin = turn(rates, cosine, sine)
    spin[2] += speed
    along = (dot(spin, d), dot(spin, n), spin[0] * t[0] + spin[1] * t[1])
    normal_rate, lagging_rate = flap_rate + along[2], lag_rate * cb - along[1]
    rates_of_blades = flap_rate, lag_rate, spin, along, normal_rate, lagging_rate
    return BladeMotion(speed, cosine, sine, d, n, t, flap, lag, *rates_of_blades)


def tilting(motion: BladeMotion, rates: Array) -> Array:
    """How fast the tip-path plane's edge goes down at (aft, right) in space, rad/s, [2, flight].

    rates : [3, flight] angular velocity of the body, shaft frame.

    Source: Johnson, Helicopter Theory, section 8.2 (rates of multi-blade coordinates).
    """
    speed = motion.speed
    tilt_aft = -2.0 * (motion.flap_rate * motion.cosine).mean(0) + 2.0 * speed * (motion.flap * motion.sine).mean(0)
    tilt_right = -2.0 * (motion.flap_rate * motion.sine).mean(0) - 2.0 * speed * (motion.flap * motion.cosine).mean(0)
    return np.stack([rates[1] + tilt_aft, tilt_right - rates[0]])


@dataclass(frozen=True)
class AirLoads:
    """Loads of the air on the blades along n and t, [blade, flight]: force, N, and its moment about the hinge, N m."""

    normal: Array
    lagging: Array
    normal_moment: Array
    lagging_moment: Array
    loading: Array  # [3, flight] thrust coefficient and its moments along (aft, right), which drive the inflow


def air_loads(
    rotor: Rotor, motion: BladeMotion, velocity: Array, inflow: Array, controls: Array, density: float
) -> AirLoads:
    """Blade elements: velocities, angle of attack, lift and drag, integrated over each blade.

    velocity : [3, flight] of the hub through the air, shaft frame.
    inflow : [3, flight] lambda0, lambda_c, lambda_s.
    controls : [3, flight] lon, lat, col, rad.
    density : kg/m^3.

    Source: Leishman, Principles of Helicopter Aerodynamics, chapter 3 (blade element analysis).
    """
    offset, speed = rotor.hinge_offset, motion.speed
    tip_speed = speed * rotor.radius
    s = rotor.stations[0][:, None, None]
    hinge = turn(velocity, motion.cosine, motion.sine)
    hinge[1] += offset * motion.spin[2]
    hinge[2] -= offset * motion.spin[1]
    # Velocity through the air is affine along the blade: along n (up) and against t (forward).
    lift_axis, gradient = motion.n[2], inflow[1] * motion.cosine + inflow[2] * motion.sine
    up0 = dot(motion.n, hinge) + lift_axis * (tip_speed * inflow[0] + speed * offset * gradient)
    up1 = motion.normal_rate + lift_axis * (speed * gradient)
    ahead0 = -(motion.t[0] * hinge[0] + motion.t[1] * hinge[1])
    up, ahead = up0 + s * up1, ahead0 - s * motion.lagging_rate
    c, k = np.cos(rotor.swash_phase), np.sin(rotor.swash_phase)
    cyclic1, cyclic2 = controls[1] * c + controls[0] * k, controls[0] * c - controls[1] * k
    pitch = controls[2] + cyclic1 * motion.cosine + cyclic2 * motion.sine
    lift, drag = rotor.section.coefficients(pitch + rotor.twist_rows - np.arctan2(up, ahead))
    pressure = (0.5 * density * rotor.chord) * np.sqrt(up * up + ahead * ahead)
    normal = pressure * (lift * ahead - drag * up)
    lagging = pressure * (lift * up + drag * ahead)
    fn, mn = (rotor.moments @ normal.reshape(rotor.elements, -1)).reshape(2, *motion.flap.shape)
    ft, mt = (rotor.moments @ lagging.reshape(rotor.elements, -1)).reshape(2, *motion.flap.shape)
    return AirLoads(fn, ft, mn, mt, _loading(rotor, motion, fn, mn, tip_speed, density))


def _loading(rotor: Rotor, motion: BladeMotion, force: Array, moment: Array, tip_speed: Array, density: float) -> Array:
    """Thrust coefficient and its first moments along (aft, right), the drive of the inflow."""
    lifted = motion.n[2] * (rotor.hinge_offset * force + moment)
    out = np.empty((3, force.shape[-1]))
    out[0] = (motion.n[2] * force).sum(0) * rotor.radius
    out[1] = (motion.cosine * lifted).sum(0)
    out[2] = (motion.sine * lifted).sum(0)
    return out / (density * rotor.disc * rotor.radius * tip_speed * tip_speed)


@dataclass(frozen=True)
class RootLoads:
    """What the blades hand to the hub, split into a part without and a part with the unknown accelerations.

    The root force of a blade is force - (light 1 + heavy d d') a, where a is the unknown part of the hinge's
    acceleration. All in body axes.
    """

    force: Array  # [3, blade, flight] N
    moment: Array  # [3, blade, flight] N m, of spring and damper, about the hinge
    d: Array  # [3, blade, flight] blade directions
    arm: Array  # [3, blade, flight] m, from the hub to the hinge
    acceleration: Array  # [3, blade, flight] m/s^2 of the hinges by velocities alone, blade frame
    light: float
    heavy: float


def root_loads(rotor: Rotor, motion: BladeMotion, air: AirLoads, centripetal: Array) -> RootLoads:
    """Root force of each blade for a hub that does not accelerate beyond what its velocities bring.

    centripetal : [3, flight] omega x (omega x hub), shaft frame, m/s^2.
    """
    mass, first, inertia = rotor.blade_mass, rotor.first_moment, rotor.flap_inertia
    a = _hinge_acceleration(rotor, motion, centripetal)
    spring_n, spring_t = _hinge_moments(rotor, motion)
    q_n, q_t = air.normal_moment + spring_n, air.lagging_moment + spring_t
    light, heavy = mass - first * first / inertia, first * first / inertia
    rate = motion.normal_rate * motion.normal_rate + motion.lagging_rate * motion.lagging_rate
    along = first * rate - heavy * dot(motion.d, a)
    normal, lagging = air.normal - first / inertia * q_n, air.lagging - first / inertia * q_t
    force = along * motion.d + normal * motion.n + lagging * motion.t - light * a
    moment = spring_t * motion.n - spring_n * motion.t
    arm = np.zeros_like(force)
    arm[0] = rotor.hinge_offset
    pack = np.stack([force, moment, motion.d, arm], axis=1)
    fixed = turn_back(pack, motion.cosine, motion.sine)
    body = (rotor.to_shaft.T @ fixed.reshape(3, -1)).reshape(fixed.shape)
    return RootLoads(body[:, 0], body[:, 1], body[:, 2], body[:, 3], a, light, heavy)


def _hinge_acceleration(rotor: Rotor, motion: BladeMotion, centripetal: Array) -> Array:
    """Acceleration of the hinges by velocities alone, blade frame, [3, blade, flight] m/s^2."""
    wr, wt, wz = motion.spin
    a = turn(centripetal, motion.cosine, motion.sine)
    a[0] -= rotor.hinge_offset * (wt * wt + wz * wz)
    a[1] += rotor.hinge_offset * (wr * wt)
    a[2] += rotor.hinge_offset * (wr * (wz + motion.speed))
    return a


def _hinge_moments(rotor: Rotor, motion: BladeMotion) -> tuple[Array, Array]:
    """Moments of springs and damper on the blade, as they enter the flap and the lag equation, N m."""
    lag = -(rotor.lag_spring * motion.lag + rotor.lag_damper * motion.lag_rate)
    return -rotor.flap_spring * motion.flap, lag / motion.n[2]


def blade_rates(
    rotor: Rotor, motion: BladeMotion, air: AirLoads, root: RootLoads, linear: Array, angular: Array
) -> Array:
    """Rates of flap, flap rate, lag, lag rate, once the accelerations of the hub are known.

    linear : [3, flight] specific force of the hub beyond the centripetal part, shaft frame, m/s^2.
    angular : [3, flight] angular acceleration of body plus rotor speed, shaft frame, rad/s^2.

    Returns [4, blade, flight].
    """
    first, inertia, offset = rotor.first_moment, rotor.flap_inertia, rotor.hinge_offset
    wd, wn, wt = motion.spin_dnt
    cb, sb = motion.n[2], motion.d[2]
    spring_n, spring_t = _hinge_moments(rotor, motion)
    alpha = turn(angular, motion.cosine, motion.sine)
    acceleration = root.acceleration + turn(linear, motion.cosine, motion.sine)
    acceleration[1] += offset * alpha[2]
    acceleration[2] -= offset * alpha[1]
    alpha[0] += motion.speed * motion.spin[1]
    alpha[1] -= motion.speed * motion.spin[0]
    b_n = (air.normal_moment + spring_n - first * dot(motion.n, acceleration)) / inertia
    b_t = (air.lagging_moment + spring_t - first * dot(motion.t, acceleration)) / inertia
    flap_rate, lag_rate = motion.flap_rate, motion.lag_rate
    out = np.empty((4, *flap_rate.shape))
    out[0], out[2] = flap_rate, lag_rate
    out[1] = b_n - dot(alpha, motion.t) - wn * wd + cb * lag_rate * (2.0 * wd - lag_rate * sb)
    out[3] = (b_t + dot(alpha, motion.n) - wt * wd + 2.0 * flap_rate * (lag_rate * sb - wd)) / cb
    return out
