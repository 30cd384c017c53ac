"""Flies a batch of drawn helicopters after measured flights: recorded controls, and feedback of the deviation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.linalg import solve_continuous_are
from scipy.ndimage import gaussian_filter1d

from rotorid_torch.simulation.drawn.draws import DrawnAircraft, Prior, level_velocity
from rotorid_torch.simulation.drawn.resemblance import Recorded
from rotorid_torch.simulation.helicopter.aircraft import CONTROL_NAMES
from rotorid_torch.simulation.multiblade.craft import BODY, EULER, FLAP, PLACE, SPEED, TORQUE
from rotorid_torch.simulation.multiblade.dynamics import respond
from rotorid_torch.simulation.multiblade.trim import find_trims, linearise
from rotorid_torch.simulation.rigid import Array, at_place

FED = ("u", "v", "w", "p", "q", "r", "phi", "theta", "psi")
VELOCITY, RATES = slice(0, 3), slice(3, 6)
ANGULAR = slice(3, 9)  # of these, what a rate and attitude controller feeds back
CONTROL_BLUR, MOTION_BLUR = 0.01, 0.1  # s: standard deviations of the kernels that take noise out of the records
CONTROL_SMOOTH = 0.06  # s: the same where controls are compared with the motion
TURN = 0.25  # rad of the rotor in one step of the integration, at most
LEAST = 1e-3  # rad: rms of a blade angle that hardly moves
EFFORT = 10.0  # price of an rms of the controls in terms of an rms of the deviation
STARTING = 0.5  # s at the beginning of a flight that tell where it starts from
TURNING = 0.05  # rad/s at which a flight that starts is not trimmed
ONE_TRIM = 2.0  # m/s between the starts of flights, up to which they are flown from one trim
EXPLAINED = 0.5  # share of a control's rms that a controller may leave over and still be one


@dataclass(frozen=True)
class Tapes:
    """What the flights prescribe, padded to one length, as deviations from trim.

    `controls` [T, 4, flight] in recorded units and `motion` [T, 9, flight] (`FED`), both without most of their noise,
    about the trim that the flight starts from, which is `trims` [flight]; `trim` is the data set's.
    `dt` and `samples` [flight]; `start` [4, flight]: psi, north, east, height; `sizes` [13]: rms of motion, controls;
    `controller` [4, 9]: how the recorded controls go with the motion where the pilot leaves them alone.
    """

    controls: Array
    motion: Array
    dt: Array
    samples: Array
    start: Array
    sizes: Array
    controller: Array
    trim: Mapping[str, float]
    trims: Sequence[Mapping[str, float]]


def tapes(flights: Sequence[Recorded], trim: Mapping[str, float]) -> Tapes:
    """The flights' controls and motion about trim."""
    longest, trims = max(flight.samples for flight in flights), _trims(flights, trim)

    def prepared(flight: Recorded, trim: Mapping[str, float], names: Sequence[str], blur: float) -> Array:
        return np.pad(_blurred(flight, names, trim, blur), ((0, longest - flight.samples), (0, 0)), mode="edge")

    paired = list(zip(flights, trims, strict=True))
    controls = np.stack([prepared(*pair, CONTROL_NAMES, CONTROL_BLUR) for pair in paired], axis=-1)
    motion = np.stack([prepared(*pair, FED, MOTION_BLUR) for pair in paired], axis=-1)
    start = np.array([[_level(flight, name, {}) for flight in flights] for name in ("psi", *_PLACES)])
    dt, samples = np.array([f.dt for f in flights]), np.array([f.samples for f in flights])
    recorded = np.arange(longest)[:, None, None] < samples
    size = np.concatenate([np.sqrt((part**2 * recorded).sum((0, 2)) / samples.sum()) for part in (motion, controls)])
    return Tapes(controls, motion, dt, samples, start, size, _controller(flights, trim), trim, trims)


def _blurred(flight: Recorded, names: Sequence[str], trim: Mapping[str, float], blur: float) -> Array:
    """Channels about where they start from, smoothed over so many s, [T, n]."""
    rows = np.stack([flight.get(name, trim.get(name, 0.0)) - _level(flight, name, trim) for name in names], axis=1)
    return gaussian_filter1d(rows, blur / flight.dt, axis=0, mode="nearest")


_PLACES = ("north", "east", "height")


def _trims(flights: Sequence[Recorded], trim: Mapping[str, float]) -> list[Mapping[str, float]]:
    """What each flight starts from: the data set's trim, or where they start at several velocities, one for each.

    That of several velocities is the mean of the flights that start there. One that starts turning is not trimmed
    there: it is flown from the nearest trim.
    """
    names = [name for name in (*FED, *CONTROL_NAMES) if name != "psi"]
    starts = [{name: _level(flight, name, {}) for name in names if name in flight.channels} for flight in flights]
    steady = [start for start in starts if all(abs(start[n] - trim.get(n, 0.0)) < TURNING for n in FED[RATES])]
    velocity = np.array([[start[name] for name in FED[VELOCITY]] for start in steady])
    group = fcluster(linkage(velocity, "complete"), ONE_TRIM, "distance") if len(steady) > 1 else np.ones(len(steady))
    if len(set(group.tolist())) <= 1:
        return [trim] * len(flights)
    alike = [[start for start, g in zip(steady, group, strict=True) if g == one] for one in np.unique(group)]
    trims = [{**trim, **{n: float(np.mean([one[n] for one in some])) for n in some[0]}} for some in alike]

    def off(start: Mapping[str, float], trim: Mapping[str, float]) -> float:
        return float(np.linalg.norm([start[name] - trim[name] for name in FED[VELOCITY]]))

    return [min(trims, key=lambda trim: off(start, trim)) for start in starts]


def _level(flight: Recorded, name: str, trim: Mapping[str, float]) -> float:
    """Where a channel starts from: trim, or for place and heading the flight's own first samples."""
    if name in trim and name != "psi":
        return trim[name]
    return float(flight.get(name, 0.0)[: max(1, round(STARTING / flight.dt))].mean())


def _controller(flights: Sequence[Recorded], trim: Mapping[str, float]) -> Array:
    """Gains of the controls by the angular motion, [4, 9], by least squares; zero where they are not a controller's.

    Every control is looked at in the half of the flights that move it least: there the pilot leaves it alone.
    """
    out = np.zeros((len(CONTROL_NAMES), len(FED)))
    for k, name in enumerate(CONTROL_NAMES):
        pairs: list[tuple[Array, Array]] = []
        for flight in flights:
            smooth = _blurred(flight, (name, *FED[ANGULAR]), trim, CONTROL_SMOOTH)
            smooth = smooth[:: max(1, round(CONTROL_SMOOTH / flight.dt))]
            pairs.append((smooth[:, 0] - smooth[:, 0].mean(), smooth[:, 1:] - smooth[:, 1:].mean(0)))
        pairs.sort(key=lambda pair: float(np.std(pair[0])))
        half = pairs[: (len(pairs) + 1) // 2]
        control, motion = np.concatenate([pair[0] for pair in half]), np.concatenate([pair[1] for pair in half])
        size = np.linalg.norm(motion, axis=0) + 1e-12
        gains = np.linalg.lstsq(motion / size, control, rcond=1e-3)[0] / size
        if np.std(control - motion @ gains) < EXPLAINED * np.std(control):
            out[k, ANGULAR] = gains
    return out


_ROWS = 27  # of a recorded sample


@dataclass(frozen=True)
class Followed:
    """What happened.

    `record` [T, 27, aircraft, flight]: body states (12), specific force, angular acceleration, flapping, rotor speed,
    torque, blade angles; `neutral` [4, aircraft, 1] and `gearing` [aircraft, 4] turn these into recorded units, about
    `level` [4]; `imu` [3, aircraft]; `samples` [flight].
    """

    record: NDArray[np.float32]
    neutral: Array
    gearing: Array
    level: Array
    imu: Array
    samples: Array

    def channels(self, aircraft: int, flight: int) -> dict[str, Array]:
        """All channels without noise, [T], in the frame of a rotor that turns counter-clockwise."""
        rows = self.record[: int(self.samples[flight]), :, aircraft, flight].astype(np.float64)
        names = ("u", "v", "w", "p", "q", "r", "phi", "theta", "psi", "north", "east", "height")
        out = dict(zip(names, rows.T, strict=False))
        velocity, felt = rows[:, :3], at_place(rows[:, 12:15], rows[:, 3:6], rows[:, 15:18], self.imu[:, aircraft])
        out |= dict(zip(("ax", "ay", "az"), felt.T, strict=True))
        out |= dict(zip(("pdot", "qdot", "rdot", "a0", "a1", "b1", "omega", "torque"), rows[:, 15:23].T, strict=True))
        moved = (rows[:, 23:] - self.neutral[:, aircraft, 0]) / self.gearing[aircraft]
        out |= dict(zip(CONTROL_NAMES, (moved + self.level).T, strict=True))
        fast = np.sqrt((velocity**2).sum(1))
        out |= {"airspeed": fast, "alpha": np.arctan2(velocity[:, 2], velocity[:, 0])}
        return out | {"beta": np.arcsin(velocity[:, 1] / np.maximum(fast, 1e-9))}

    def away(self, tape: Tapes) -> Array:
        """Rms of the difference from the measured motion over the motion's own, the worst of `FED`, [aircraft]."""
        recorded = np.arange(len(self.record))[:, None] < self.samples
        flown = self.record[:, : len(FED)].astype(np.float64)
        with np.errstate(all="ignore"):
            off = flown - flown[:1] - (tape.motion - tape.motion[:1])[:, :, None]
            square = np.where(recorded[:, None, None], off * off, 0.0).sum((0, 3)) / recorded.sum()
            worst = (np.sqrt(square) / np.maximum(tape.sizes[: len(FED), None], LEAST)).max(0)
        return np.where(np.isfinite(worst), worst, np.inf)


def gains(aircraft: DrawnAircraft, prior: Prior, tape: Tapes) -> Array:
    """Feedback of `FED` to lon lat col ped, rad, [aircraft, 4, 9].

    The controller of the recorded flights, and around it as little as keeps the aircraft near them: linear-quadratic,
    weighed by the flights' rms. So controls go with the motion as they did in flight, and no better conditioned.

    Source: Anderson and Moore, Optimal Control: Linear Quadratic Methods, chapter 3.
    """
    table = linearise(aircraft.craft, aircraft.trims).derivatives()
    out = aircraft.gearing[:, :, None] * tape.controller
    weight = np.diag(1.0 / np.maximum(tape.sizes[:9], 1e-3) ** 2)
    for k, derivatives in enumerate(table):
        a, b = body_system(derivatives, aircraft.trims.state[:, k, 0], prior.vehicle.gravity)
        price = EFFORT * np.diag(1.0 / np.maximum(np.abs(aircraft.gearing[k]) * tape.sizes[9:], LEAST) ** 2)
        answer = solve_continuous_are(a + b @ out[k], b, weight, price)
        out[k] -= np.linalg.solve(price, b.T @ answer)
    return out


def body_system(derivatives: Array, x: Array, gravity: float) -> tuple[Array, Array]:
    """Linear model of the nine states `FED` and its inputs, [9, 9] and [9, 4], of derivatives [6, 10] about trim."""
    (u, v, w), (phi, theta) = x[BODY], x[EULER][:2]
    a, b = np.zeros((9, 9)), np.zeros((9, 4))
    a[:6, :6], b[:6] = derivatives[:, :6], derivatives[:, 6:]
    a[:3, 3:6] += np.array([[0.0, -w, v], [w, 0.0, -u], [-v, u, 0.0]])
    cp, sp, ct, st = np.cos(phi), np.sin(phi), np.cos(theta), np.sin(theta)
    a[:3, 6] = gravity * np.array([0.0, ct * cp, -ct * sp])
    a[:3, 7] = -gravity * np.array([ct, st * sp, st * cp])
    a[6, 3:6] = 1.0, sp * st / ct, cp * st / ct
    a[7, 4:6] = cp, -sp
    a[8, 4:6] = sp / ct, cp / ct
    return a, b


def _starts(aircraft: DrawnAircraft, tape: Tapes, prior: Prior) -> tuple[Array, Array]:
    """States [31, aircraft, flight] and controls [4, aircraft, flight] of the trims that the flights start from.

    NaN where an aircraft finds none at a flight's velocity.
    """
    trims, velocities = aircraft.trims, [level_velocity(trim) for trim in tape.trims]
    state, controls = (np.repeat(part, len(velocities), axis=2) for part in (trims.state, trims.controls))
    for velocity in np.unique(velocities, axis=0):
        if np.array_equal(velocity, prior.velocity):
            continue
        equilibria = find_trims(aircraft.craft, velocity, trims)
        flown = np.array([np.array_equal(velocity, one) for one in velocities])
        state[..., flown] = np.where(equilibria.converged[:, None], equilibria.state, np.nan)
        controls[..., flown] = np.where(equilibria.converged[:, None], equilibria.controls, np.nan)
    return state, controls


@np.errstate(over="ignore", invalid="ignore")
def follow(aircraft: DrawnAircraft, tape: Tapes, prior: Prior, gusts: Array | None = None) -> Followed:
    """Fly every aircraft through every flight.

    Its blade angles are trim + gearing x recorded + gains x (own motion - measured motion), all from trim: its own, at
    the velocity that the flight starts with. What its record shows of them is in the units of the data set, about its
    trim: rigging is not its business.
    One that flies away ends in numbers that are not finite.

    gusts : velocity of the air [T, 3, aircraft, flight], body axes, m/s; still without.
    """
    craft, trims = aircraft.craft, aircraft.trims
    feed = gains(aircraft, prior, tape)
    fed = slice(0, len(FED))
    x, neutral_controls = _starts(aircraft, tape, prior)
    x[8], x[PLACE] = tape.start[0], tape.start[1:, None]
    neutral = x[fed].copy()
    x[fed] += tape.motion[0][:, None]
    hands = aircraft.gearing.T[:, :, None] * tape.controls[:, :, None]
    hands -= np.einsum("dij,tjf->tidf", feed, tape.motion)
    hands += neutral_controls
    level = np.array([tape.trim.get(name, 0.0) for name in CONTROL_NAMES])
    substeps = int(np.ceil(float((tape.dt.max() * craft.speed).max()) / TURN))

    def commanded(state: Array, hand: Array) -> Array:
        return hand + (feed @ (state[fed] - neutral).swapaxes(0, 1)).swapaxes(0, 1)

    def slope(state: Array, t: int, share: float) -> Array:
        hand, gust = (part[t] + share * (part[t + 1] - part[t]) for part in (hands, air))
        return respond(craft, trims.setting, state, commanded(state, hand), gust)[0]

    air = np.zeros((len(hands), 1, 1, 1)) if gusts is None else gusts
    last = len(hands) - 1
    record = np.full((last + 1, _ROWS, *x.shape[1:]), np.nan, dtype=np.float32)
    for t in range(last + 1):
        u = commanded(x, hands[t])
        first, response = respond(craft, trims.setting, x, u, air[t])
        rows = record[t]
        rows[:12], rows[12:15], rows[15:18], rows[18:21] = x[:12], response.specific_force, response.angular, x[FLAP]
        rows[21], rows[22], rows[23:] = x[SPEED], response.shaft if craft.held else x[TORQUE], u
        step = np.where(t < tape.samples - 1, tape.dt, 0.0) / substeps
        for k in range(substeps if t < last else 0):
            first = slope(x, t, k / substeps) if k else first
            x = x + step * slope(x + 0.5 * step * first, t, (k + 0.5) / substeps)
    return Followed(record, trims.controls, aircraft.gearing, level, craft.imu[..., 0], tape.samples)
