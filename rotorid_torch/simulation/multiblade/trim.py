"""Trim and linear models of a batch of helicopters: points and differences (see `dynamics`)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rotorid_torch.simulation.helicopter.rotor import turn_back
from rotorid_torch.simulation.multiblade import dynamics
from rotorid_torch.simulation.multiblade.craft import (
    BODY,
    EULER,
    FLAP,
    FLAP_RATE,
    INFLOW,
    LAG,
    LAG_RATE,
    RATES,
    SPEED,
    SPEED_ERROR,
    STATES,
    TAIL_INFLOW,
    TORQUE,
    Choice,
    Craft,
    Mask,
    Setting,
    to_body,
)
from rotorid_torch.simulation.rigid import Array, skew

Complex = NDArray[np.complex128]

ROWS = [6, 7, *range(FLAP.start, FLAP.stop), *range(LAG.start, LAG.stop), *range(INFLOW.start, INFLOW.stop), 27]
"""Rows of the state that trim looks for, besides the four controls: bank, pitch, flap, lag, inflows."""
INNER = [*range(FLAP.start, STATES)]
"""Rows of rotor, inflow and drive: what a linear model of the body follows."""
SHIFT = 1e-4  # perturbation of a state or control for a derivative, SI
CLOSE, STEPS = 1e-8, 25  # residual acceleration of a trim, m/s^2 and rad/s^2; Newton steps at most
SETTLED = 4  # steps after which the mass matrix is that of trim


@dataclass(frozen=True)
class Trims:
    """Trimmed flights: `state` [31, aircraft, 1], `controls` [4, aircraft, 1] rad, `found` [aircraft]."""

    state: Array
    controls: Array
    setting: Setting
    converged: Mask

    def pick(self, which: Choice) -> Trims:
        """The trims of some of the aircraft."""
        parts = self.setting
        stations, first, second = (part[:, :, which] for part in (parts.stations, *parts.weights))
        body = parts.body[0][:, which], parts.body[1][:, :, which]
        setting = Setting(stations, (first, second), parts.inverse[which], parts.relax[which], body)
        return Trims(self.state[:, which], self.controls[:, which], setting, self.converged[which])


@dataclass(frozen=True)
class Linears:
    """Linear models about trim, each [aircraft, ...]: rates of the inner states, and what follows from them.

    Inner states (19) are those of rotor, inflow and drive, outer inputs (10) u v w p q r lon lat col ped; `load_inner`
    [aircraft, 7, 19] and `load_outer` [aircraft, 7, 10]: specific force, angular acceleration, rotor speed.
    """

    inner: Array
    outer: Array
    load_inner: Array
    load_outer: Array

    def derivatives(self) -> Array:
        """X Y Z (m/s^2), L M N (rad/s^2) by u v w p q r lon lat col ped once all else followed, [aircraft, 6, 10]."""
        return (self.load_outer - self.load_inner @ np.linalg.solve(self.inner, self.outer))[:, :6]

    def loads(self, frequency: Array, motion: Complex) -> Complex:
        """X Y Z (m/s^2), L M N (rad/s^2), rotor speed (rad/s) that go with a motion, [aircraft, frequency, 7].

        frequency : [frequency] rad/s.
        motion : [aircraft, frequency, 10] transforms of u v w p q r lon lat col ped.
        """
        poles, modes = np.linalg.eig(self.inner)
        driven = motion @ np.linalg.solve(modes, self.outer + 0j).swapaxes(-1, -2)
        followed = driven / (1j * frequency[:, None] - poles[:, None])
        through = (self.load_inner @ modes).swapaxes(-1, -2)
        return motion @ self.load_outer.swapaxes(-1, -2) + followed @ through


def mass_matrix(craft: Craft, x: Array) -> Array:
    """Matrix M of Kane's equations, [aircraft, 13, 13], blades where the states x [31, aircraft, 1] put them."""
    mass, first, inertia = dynamics.body_inertia(craft)
    out = np.zeros((craft.count, dynamics.UNKNOWNS, dynamics.UNKNOWNS))
    out[:, :3, :3] = mass[:, :, None] * np.eye(3)
    out[:, 3:6, :3], out[:, :3, 3:6] = skew(first[..., 0].T), -skew(first[..., 0].T)
    out[:, 3:6, 3:6] = inertia[..., 0].transpose(2, 0, 1)
    out[:, 6, 6] = craft.drive_inertia[:, 0]
    moving = _blade_matrix(craft, x)
    up = to_body(craft.tilt, np.array([0.0, 0.0, 1.0])[:, None, None] * np.ones_like(craft.hub))[..., 0].T
    steady = np.zeros_like(moving)
    # A rotor whose flapping is quasi-steady only turns: its blades ride with the body otherwise.
    steady[:, 6, 6] = moving[:, 6, 6]
    steady[:, 3:6, 6] = steady[:, 6, 3:6] = up * moving[:, 6, 6, None]
    return out + np.where(craft.steady_flap[:, None, None], steady, moving)


def _blade_matrix(craft: Craft, x: Array) -> Array:
    """Part of the mass matrix that the blades make."""
    spin = np.zeros((3, dynamics.AZIMUTHS, craft.count, 1))
    blades = dynamics.blade_motion(x, spin, x[SPEED])

    def body(vector: Array) -> Array:
        return to_body(craft.tilt, turn_back(vector, dynamics.COSINE, dynamics.SINE))[..., 0].transpose(1, 2, 0)

    d, n, t = body(blades.d), body(blades.n), body(blades.t)
    ahead = np.zeros_like(blades.d)
    ahead[0] = craft.hinge_offset
    radial = body(ahead)
    up = to_body(craft.tilt, np.array([0.0, 0.0, 1.0])[:, None, None] * np.ones_like(craft.hub))[..., 0].T
    at_hinge = np.zeros((dynamics.AZIMUTHS, craft.count, 3, dynamics.UNKNOWNS))
    along = np.zeros_like(at_hinge)
    at_hinge[..., :3] = np.eye(3)
    at_hinge[..., 3:6], along[..., 3:6] = -skew(craft.hub[..., 0].T + radial), -skew(d)
    at_hinge[..., 6], along[..., 6] = np.cross(up, radial), np.cross(up, d)
    along[..., 7:10] = n[..., None] * dynamics.FLAP_SHAPES[..., 0].transpose(1, 2, 0)[:, :, None]
    cosine = np.cos(blades.flap)[..., 0]
    along[..., 10:13] = (cosine[..., None] * t)[..., None] * dynamics.LAG_SHAPES[..., 0].transpose(1, 2, 0)[:, :, None]
    mass, first, second = (v[:, :, None] for v in (craft.blade_mass, craft.first_moment, craft.flap_inertia))
    both = at_hinge.swapaxes(-1, -2) @ along
    square = mass * (at_hinge.swapaxes(-1, -2) @ at_hinge) + second * (along.swapaxes(-1, -2) @ along)
    return (craft.blades / dynamics.AZIMUTHS) * (square + first * (both + both.swapaxes(-1, -2))).sum(0)


def settle(craft: Craft, x: Array, controls: Array) -> Setting:
    """What is constant in flights about the states x [31, aircraft, 1] and the controls [4, aircraft, 1]."""
    held = np.zeros((craft.count, dynamics.UNKNOWNS), dtype=bool)
    held[:, 6] = craft.held
    held[:, 7:10] = craft.steady_flap[:, None]
    held[:, 10:13] = craft.stiff_lag[:, None]
    out = held[:, :, None] | held[:, None, :]
    inverse = np.linalg.inv(np.where(out, np.eye(dynamics.UNKNOWNS), mass_matrix(craft, x)))
    relax = np.zeros((craft.count, 3, 3))
    elements, body = dynamics.blade_elements(craft), dynamics.body_inertia(craft)[1:]
    setting = Setting(*elements, np.where(out, 0.0, inverse), relax, body)
    if not craft.steady_flap.any():
        return setting
    shift = 1e-4
    batch = np.repeat(x, 4, axis=2)
    batch[FLAP, :, 1:] += shift * np.eye(3)[:, None]
    moment = dynamics.respond(craft, setting, batch, np.broadcast_to(controls, (4, craft.count, 4)))[1].flap_moment
    stiffness = ((moment[:, :, :1] - moment[:, :, 1:]) / shift).transpose(1, 0, 2)
    relax = np.linalg.inv(stiffness) * (craft.steady_flap / craft.relaxation)[:, None, None]
    return replace(setting, relax=relax)


def find_trims(craft: Craft, velocity: Array, guess: Trims | None = None, close: float = CLOSE) -> Trims:
    """Steady straight flight of every aircraft, by Newton's method with differences.

    velocity : [3] m/s level ahead, to the side, and down.
    guess : trims of similar aircraft.
    close : residual acceleration that counts as trimmed, m/s^2 and rad/s^2.
    """
    x, controls = (guess.state.copy(), guess.controls.copy()) if guess is not None else _guess(craft)
    x[SPEED] = craft.speed
    free, craft = craft, replace(craft, held=True)
    shift, size = 1e-6, len(ROWS) + 4
    converged = np.zeros(craft.count, dtype=bool)
    setting = settle(craft, _placed(x, velocity), controls)
    for step in range(STEPS):
        if 0 < step < SETTLED:
            setting = settle(craft, _placed(x, velocity), controls)
        batch, hands = np.repeat(x, size + 1, axis=2), np.repeat(controls, size + 1, axis=2)
        batch[ROWS, :, 1 : len(ROWS) + 1] += shift * np.eye(len(ROWS))[:, None]
        hands[:, :, len(ROWS) + 1 :] += shift * np.eye(4)[:, None]
        left = _residual(craft, setting, _placed(batch, velocity), hands)
        wrong = ~np.isfinite(left).all(axis=(0, 2))
        left[:, wrong] = 0.0
        converged = (np.abs(left[:, :, 0]).max(0) < close) & ~wrong
        if (converged | wrong).all():
            break
        jacobian = ((left[:, :, 1:] - left[:, :, :1]) / shift).transpose(1, 0, 2)
        jacobian[wrong] = np.eye(size)
        change = -np.linalg.solve(jacobian + 1e-12 * np.eye(size), left[:, :, :1].transpose(1, 0, 2))
        change *= np.minimum(1.0, 0.3 / np.maximum(np.abs(change).max(1, keepdims=True), 1e-12))
        change *= ~converged[:, None, None]
        x[ROWS] += change[:, : len(ROWS)].transpose(1, 0, 2)
        controls += change[:, len(ROWS) :].transpose(1, 0, 2)
    x = _placed(x, velocity)
    if not free.held:
        x[TORQUE] = dynamics.respond(craft, setting, x, controls)[1].shaft
        x[SPEED_ERROR] = x[TORQUE] / craft.governor_integral
        setting = settle(free, x, controls)
    return Trims(x, controls, setting, converged)


def _placed(x: Array, velocity: Array) -> Array:
    """The states with the velocity turned into the body axes that their attitudes make."""
    out = x.copy()
    phi, theta = x[EULER][:2]
    ahead, side, down = velocity
    cp, sp, ct, st = np.cos(phi), np.sin(phi), np.cos(theta), np.sin(theta)
    out[0] = ct * ahead - st * down
    out[1] = sp * st * ahead + cp * side + sp * ct * down
    out[2] = cp * st * ahead - sp * side + cp * ct * down
    return out


def _residual(craft: Craft, setting: Setting, x: Array, controls: Array) -> Array:
    """What is left to trim, [16, aircraft, flight]; what does not move is to be zero itself."""
    dx = dynamics.respond(craft, setting, x, controls)[0]
    flap = np.where(craft.steady_flap[:, None], dx[FLAP] * craft.speed**2, dx[FLAP_RATE])
    lag = np.where(craft.stiff_lag[:, None], x[LAG], dx[LAG_RATE])
    gradient = np.where(craft.inflow_speed[1] == 0.0, x[INFLOW][1:], dx[INFLOW][1:])
    return np.concatenate([dx[BODY], dx[RATES], flap, lag, dx[INFLOW][:1], gradient, dx[[TAIL_INFLOW]]])


def _guess(craft: Craft) -> tuple[Array, Array]:
    """Momentum-theory guess of the hover."""
    weight = craft.mass * craft.gravity
    tip_speed = craft.speed * craft.radius
    thrust = weight / (craft.density * np.pi * craft.radius**2 * tip_speed**2)
    solidity, mean = craft.blades * craft.chord / (np.pi * craft.radius), np.sqrt(thrust / 2.0)
    collective = 3.3 * (2.0 * thrust / (solidity * craft.lift_slope) + 0.5 * mean) - 0.75 * craft.twist
    side = weight * mean * craft.radius * 1.35 / np.abs(craft.tail_position[0]) / craft.tail_blockage
    tail_tip = craft.tail_gear * craft.speed * craft.tail_radius
    tail_thrust = side / (craft.density * np.pi * craft.tail_radius**2 * tail_tip**2)
    tail_mean = np.sqrt(tail_thrust / 2.0)
    pedal = 2.0 * tail_thrust / (craft.tail_solidity * craft.tail_lift_slope) + 0.5 * tail_mean
    x = np.zeros((STATES, craft.count, 1))
    x[SPEED], x[INFLOW.start], x[TAIL_INFLOW] = craft.speed, mean, tail_mean
    x[6], x[7] = -side / weight, craft.tilt
    stiff = craft.flap_inertia + craft.hinge_offset * craft.first_moment
    x[FLAP.start] = 0.7 * weight / craft.blades * craft.radius / (stiff * craft.speed**2)
    zero = np.zeros_like(mean)
    return x, np.stack([zero, zero, collective, 3.3 * pedal - 0.75 * craft.tail_twist])


def linearise(craft: Craft, trims: Trims) -> Linears:
    """Linear models by central differences."""
    rows = [*INNER, *range(6)]
    size = len(rows) + 4
    shifts = SHIFT * np.concatenate([np.eye(size), -np.eye(size)], axis=1)
    batch, hands = np.repeat(trims.state, 2 * size, axis=2), np.repeat(trims.controls, 2 * size, axis=2)
    batch[rows] += shifts[: len(rows), None]
    hands += shifts[len(rows) :, None]
    dx, response = dynamics.respond(craft, trims.setting, batch, hands)
    out = np.concatenate([dx[INNER], response.specific_force, response.angular, batch[[SPEED]]])
    jacobian = ((out[:, :, :size] - out[:, :, size:]) / (2.0 * SHIFT)).transpose(1, 0, 2)
    inner = jacobian[:, : len(INNER), : len(INNER)]
    # What does not move has zero rates; it returns by itself here, so that it can be eliminated.
    still = np.abs(jacobian[:, : len(INNER)]).max(2) == 0.0
    still[:, LAG.start - FLAP.start : LAG_RATE.stop - FLAP.start] |= craft.stiff_lag[:, None]
    inner = inner - np.eye(len(INNER)) * still[:, :, None]
    outer, load = jacobian[:, : len(INNER), len(INNER) :], jacobian[:, len(INNER) :]
    return Linears(inner, outer, load[:, :, : len(INNER)], load[:, :, len(INNER) :])
