"""A batch of flights: trim, augmentation and pilot make the commands, the aircraft answers, samples are taken."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rotorid_torch.simulation.flight.augmentation import FEEDBACK, Augmentation
from rotorid_torch.simulation.flight.hidden_signals import hidden_signals
from rotorid_torch.simulation.flight.manoeuvres import SAMPLE_RATE, pilot
from rotorid_torch.simulation.flight.motion import Motion, Outside, rates
from rotorid_torch.simulation.flight.runge_kutta import runge_kutta
from rotorid_torch.simulation.flight.trim import STEP_ANGLE, Trim
from rotorid_torch.simulation.helicopter.aircraft import CONTROLS, EULER, PLACE, Aircraft
from rotorid_torch.simulation.helicopter.atmosphere import Passage, gusts
from rotorid_torch.simulation.helicopter.control_path import History
from rotorid_torch.simulation.rigid import Array

Progress = Callable[[int, int], None]
"""progress(done, total) in samples."""


@dataclass(frozen=True)
class FlightHistory:
    """What happened, without noise: `time` [T], `states` [T, states, flight], and `Motion`'s parts [T, 3, flight].

    `hidden`: what only an altered aircraft has, [T, flight] each, by the name of its truth channel (`hidden_signals`).
    """

    time: Array
    states: Array
    specific_force: Array
    angular: Array
    force: Array
    moment: Array
    hidden: dict[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Programme:
    """What is flown in one batch.

    flights : names of manoeuvres. seconds : length of each. seed : of the gusts.
    substeps : integration steps per sample; by default so many that the rotor turns at most 5.1 degrees in each.
    """

    flights: Sequence[str]
    seconds: float
    seed: int = 0
    substeps: int | None = None

    @property
    def samples(self) -> int:
        """Samples of each flight."""
        return round(self.seconds * SAMPLE_RATE) + 1


def fly_batch(
    aircraft: Aircraft,
    trim: Trim | Sequence[Trim],
    augmentation: Augmentation | Sequence[Augmentation],
    programme: Programme,
    progress: Progress | None = None,
) -> FlightHistory:
    """Fly manoeuvres from trim, all in one batch.

    trim, augmentation : of all flights, or one for each.
    progress : called about a hundred times.
    """
    substeps = programme.substeps or int(np.ceil(aircraft.rotor.speed / SAMPLE_RATE / STEP_ANGLE - 1e-6))
    dt = 1.0 / SAMPLE_RATE / substeps
    lead = round(ENTRY * SAMPLE_RATE) if aircraft.turbulence else 0
    flights, entry = programme.flights, lead * substeps
    trims = [trim] * len(flights) if isinstance(trim, Trim) else list(trim)
    steps = (programme.samples - 1) * substeps + entry
    times = _stage_times(steps + substeps, dt) - lead * (1.0 / SAMPLE_RATE)
    stick = pilot(flights, times.ravel(), aircraft.limits).reshape(4, *times.shape, len(flights))
    x = np.stack([one.state for one in trims], axis=1)
    controls = np.stack([one.controls for one in trims], axis=1)
    feedback = _feedback(augmentation, x[FEEDBACK].copy())
    surroundings = _Surroundings(aircraft, flights, trims, times, dt, programme.seed)
    samples = _Samples(programme.samples, progress)

    def respond(state: Array, hand: Array) -> tuple[Array, Motion]:
        return rates(aircraft, state, controls + hand[:4] + feedback(state), surroundings.unpack(hand))

    for step in range(steps + 1):
        surroundings.begin(x[CONTROLS])
        start = surroundings.pack(stick[:, step, 0], step, 0)
        first, motion = respond(x, start)
        if step >= entry and (step - entry) % substeps == 0:
            samples.take(x, motion, hidden_signals(aircraft, x, first, surroundings.unpack(start)))
        if step < steps:
            surroundings.rate(first[CONTROLS])
            middle, end = (surroundings.pack(stick[:, step, stage], step, stage) for stage in (1, 2))
            x = runge_kutta(lambda state, hand: respond(state, hand)[0], x, first, (start, middle, end), dt)
    return samples.history()


class _Samples:
    """What happens, sample by sample."""

    def __init__(self, count: int, progress: Progress | None) -> None:
        self.count, self.progress = count, progress
        self.states, self.motions, self.hidden = list[Array](), list[Motion](), list[dict[str, Array]]()

    def take(self, state: Array, motion: Motion, hidden: dict[str, Array]) -> None:
        self.states.append(state)
        self.motions.append(motion)
        self.hidden.append(hidden)
        done = len(self.states)
        if self.progress is not None and ((done - 1) % PROGRESS == 0 or done == self.count):
            self.progress(done, self.count)

    def history(self) -> FlightHistory:
        time = np.arange(self.count, dtype=np.float64) * (1.0 / SAMPLE_RATE)
        parts = (np.stack([getattr(one, n) for one in self.motions]) for n in MOTION)
        hidden = {name: np.stack([row[name] for row in self.hidden]) for name in self.hidden[0]}
        return FlightHistory(time, np.stack(self.states), *parts, hidden=hidden)


MOTION = ("specific_force", "angular", "force", "moment")
"""Parts of `Motion` in a history."""
PROGRESS = 23
"""Samples from one word of progress to the next."""
ENTRY = 4.0  # s in turbulence before the record begins; it grows from nothing over the first half of them


def _feedback(augmentation: Augmentation | Sequence[Augmentation], neutral: Array) -> Callable[[Array], Array]:
    """The augmentation's part of the commands, [4, flight], from the states; `neutral`: what it holds, [6, flight]."""
    if isinstance(augmentation, Augmentation):
        gains = augmentation.gains
        return lambda state: gains @ (state[FEEDBACK] - neutral)
    each = np.stack([one.gains for one in augmentation])
    return lambda state: np.einsum("kij,jk->ik", each, state[FEEDBACK] - neutral)


class _Surroundings:
    """Gusts and delayed controls, packed below the stick's rows at every stage of every step."""

    def __init__(
        self, aircraft: Aircraft, flights: Sequence[str], trims: Sequence[Trim], times: Array, dt: float, seed: int
    ) -> None:
        delay = aircraft.path.delay if aircraft.path else 0.0
        self.history = History(delay, dt) if delay else None
        self.gusts = None
        if aircraft.turbulence is not None:
            wind = np.hypot(*aircraft.wind[:2]) if aircraft.wind else 0.0
            passages = [Passage(one.state[11], max(one.speed, wind)) for one in trims]
            every = zip(flights, passages, strict=True)
            rows = [gusts(aircraft.turbulence, passage, dt, len(times), name, seed) for name, passage in every]
            entry = np.clip((np.arange(len(times) + 1) * dt) / (0.5 * ENTRY), 0.0, 1.0)
            at_steps = np.stack(rows, axis=2) * entry[None, :, None]
            start, end = at_steps[:, :-1], at_steps[:, 1:]
            self.gusts = np.stack([start, 0.5 * (start + end), end], axis=2)

    def begin(self, controls: Array) -> None:
        """A step begins with these recorded controls, [4, flight]."""
        if self.history is not None:
            self.history.keep(controls)

    def rate(self, rate: Array) -> None:
        """The rate of the recorded controls at the step's beginning."""
        if self.history is not None:
            self.history.rate = rate

    def pack(self, stick: Array, step: int, stage: int) -> Array:
        """Rows of one stage (0 start, 1 middle, 2 end): stick, gust, delayed controls and their rates."""
        rows = [stick]
        if self.gusts is not None:
            rows.append(self.gusts[:, step, stage])
        if self.history is not None:
            rows.extend(self.history.read(0.5 * stage))
        return stick if len(rows) == 1 else np.concatenate(rows)

    def unpack(self, hand: Array) -> Outside:
        """Gust and delayed controls of packed rows."""
        remaining = hand[4:]
        gust = None
        if self.gusts is not None:
            gust, remaining = remaining[:3], remaining[3:]
        return Outside(gust, (remaining[:4], remaining[4:]) if self.history is not None else None)


def _stage_times(steps: int, dt: float) -> Array:
    """Start, middle and end of every step, [steps, 3], drawn in a little so that a stick's jump belongs to one side."""
    return np.arange(steps)[:, None] * dt + np.array([1e-6, 0.5, 1.0 - 1e-6]) * dt


def with_heading(trim: Trim, heading: float) -> Trim:
    """The same trim, flown towards another heading (rad)."""
    return _with_row(trim, EULER.stop - 1, trim.state[EULER.stop - 1] + heading)


def with_height(trim: Trim, height: float) -> Trim:
    """The same trim, flown at another height (m)."""
    return _with_row(trim, PLACE.stop - 1, height)


def _with_row(trim: Trim, row: int, value: float) -> Trim:
    state = trim.state.copy()
    state[row] = value
    return replace(trim, state=state)
