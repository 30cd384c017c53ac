"""Effects that no trajectory can show, because their phase is unknown: turbulence and vibration.

Turbulence: before the pilot acts all flights are alike, or drift slowly where they are not quite in trim; what differs
between them beyond that and sensor noise is the air.
Vibration: lines in accelerations and rates at multiples of the rotor speed.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorid_torch.consistency.records.vibration import SEGMENT_S, lines, spectrum
from rotorid_torch.core.names import RATES, SPECIFIC_FORCES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.families.environment import Turbulence, Vibration
from rotorid_torch.effects.registry import registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.trace.search.decide import Row
from rotorid_torch.trace.search.words import finding
from rotorid_torch.trace.terms.finding import EffectFinding
from rotorid_torch.trace.terms.settings import SETTINGS

TURBULENCE, VIBRATION = Turbulence.id, Vibration.id
BLOCK_S = 0.1
"""Quiet records are averaged over this: gusts are slower, sensor noise averages out."""
LEAST_FLIGHTS, LEAST_BLOCKS = 4, 5
DRIFT = 2
"""Order of the polynomial that a flight's beginning follows where it is not quite in trim: no gust."""
LINE_HZ = 1.0 / SEGMENT_S
"""From one line of a spectrum to the next: so far from its place a line may lie, or from a multiple of the rotor."""

CALM = "before the pilot acts all flights are alike"
SLOW = "before the pilot acts flights differ by slow drifts alone, as they do in slow gusts or not quite in trim"
OF_ONE = "a single flight shows it"
GUSTY = (
    "before the pilot acts the flights differ by more than their sensors' noise, in {} most;"
    " output error takes gusts for noise: derivatives are biased, fly in calmer air; gusts slower than these"
    " moments are not in the size"
)
NO_LINE = "no line at a multiple of the rotor speed is stronger than a sensor's noise"

Spectra = Mapping[str, Sequence[float]]
"""Frequencies of lines by channel."""


def stochastic_findings(dataset: Dataset, spec: ModelSpec, response: Mapping[str, float]) -> list[EffectFinding]:
    """Findings of turbulence and vibration.

    response : what a gust of 1 m/s along its axis does to each accelerometer, m/s2; turns accelerations into gusts.
    """
    return [_turbulence(quiet_moments(dataset, spec), response), _vibration(dataset, spec)]


@dataclass(frozen=True, eq=False)
class QuietMoments:
    """What flights do before the pilot acts.

    means : of blocks of accelerations and rates [flight, block, channel]. noise : sd of a block by the sensors
    [channel]. lacking : why nothing can be told, in words.
    """

    channels: Sequence[str]
    means: np.ndarray
    noise: np.ndarray
    lacking: str | None

    @property
    def ratio(self) -> np.ndarray:
        """Mean square by channel of what differs between flights beyond their own drifts, over that of the noise."""
        return _between(self.means) / self.noise**2

    @property
    def critical(self) -> float:
        """What noise alone exceeds in any channel at the level."""
        return _critical_ratio(_freedom(self.means.shape), SETTINGS.gusts / len(self.channels))

    @property
    def alike(self) -> bool:
        """Whether flights differ by noise alone, levels and drifts too: gusts slower than these moments would show."""
        if self.lacking is not None:
            return False
        flights, blocks = self.means.shape[:2]
        off = ((self.means - self.means.mean(axis=0)) ** 2).sum(axis=(0, 1)) / self.noise**2
        freedom = (flights - 1) * blocks
        return bool((off / freedom).max() <= _critical_ratio(freedom, SETTINGS.gusts / len(self.channels)))

    @property
    def shaken(self) -> bool:
        """Whether flights differ by more than drifts and noise, whichever flight is left out."""
        if self.lacking is not None:
            return False
        worst = int(np.argmax(self.ratio))
        without = [replace(self, means=np.delete(self.means, k, axis=0)).ratio[worst] for k in range(len(self.means))]
        return bool(min(self.ratio[worst], *without) > self.critical)


def quiet_moments(dataset: Dataset, spec: ModelSpec) -> QuietMoments:
    """Of the identify and validate flights of a data set, for a model of this structure."""
    names = (*dataset.identify, *dataset.validate)
    channels = [c for c in (*SPECIFIC_FORCES, *RATES) if all(dataset.facts[n].has(c) for n in names)]
    spectra = _vibrating(dataset, channels) if channels else {}
    blocks = [_quiet_blocks(dataset, n, channels, spectra) for n in names]
    count = min((len(b) for b in blocks), default=0)
    lacking = registered()[TURBULENCE].untestable(spec)
    if lacking is None and (len(names) < LEAST_FLIGHTS or count < LEAST_BLOCKS or not channels):
        lacking = f"needs {LEAST_FLIGHTS} flights that begin with {LEAST_BLOCKS * BLOCK_S:g} s before the pilot acts"
    if lacking is None and _pilot_acts(dataset, names, spectra):
        lacking = "the flights do not begin in trim: controls or rates move from the first sample on"
    means = np.stack([b[:count] for b in blocks]) if blocks else np.zeros((0, 0, 0))
    each = round(BLOCK_S / dataset.facts[names[0]].dt)
    noise = np.array([dataset.noise(c) for c in channels]) / math.sqrt(each)
    return QuietMoments(channels, means, noise, lacking)


def _turbulence(quiet: QuietMoments, response: Mapping[str, float]) -> EffectFinding:
    if quiet.lacking is not None:
        return finding(TURBULENCE, Row(testable=False), lacking=quiet.lacking)
    channels, ratio, critical, noise = quiet.channels, quiet.ratio, quiet.critical, quiet.noise
    worst = int(np.argmax(ratio))
    row = Row(significant=bool(ratio[worst] > critical), unseen_better=quiet.shaken)
    calm = CALM if quiet.alike else SLOW
    said = calm if not row.significant else OF_ONE if not row.unseen_better else GUSTY.format(channels[worst])
    moved = np.array([response.get(c, 0.0) for c in channels])
    most = int(np.argmax(np.where(ratio > critical, moved, 0.0)))  # the others tell of attitudes that gusts upset
    one = finding(TURBULENCE, row, said)
    size = {}
    if one.verdict == "accepted" and moved[most] > 0.0 and ratio[most] > critical:
        beyond = noise[most] * math.sqrt(max(float(ratio[most]) - 1.0, 0.0))
        size = {f"{TURBULENCE}.intensity": (float(beyond / moved[most]), 0.0)}
    visible = _visible(response, noise, channels, critical)
    return replace(one, statistic=float(ratio[worst]), critical_value=critical, smallest_visible=visible, values=size)


def _quiet_blocks(dataset: Dataset, name: str, channels: Sequence[str], spectra: Spectra) -> np.ndarray:
    """Means over blocks of the quiet part of a flight, [block, channel], lines of vibration taken out."""
    flight = dataset.flights[name]
    each = max(1, round(BLOCK_S / flight.dt))
    record = flight.bridged(channels).numpy()[: dataset.quiet(name) // each * each]
    for k, channel in enumerate(channels):
        for hertz in spectra.get(channel, ()):
            record[:, k] -= _sine(record[:, k], hertz, flight.dt)
    return record.reshape(-1, each, len(channels)).mean(axis=1)


def _vibrating(dataset: Dataset, channels: Sequence[str]) -> Spectra:
    """Frequencies in Hz of lines that stand above a channel's noise: what blocks leave of them is no gust."""
    dt = dataset.facts[dataset.identify[0]].dt
    strong = {c: lines(*spectrum(dataset.records(c), dt)) for c in channels}
    return {c: [one.hertz for one in some if one.rms > dataset.noise(c)] for c, some in strong.items()}


def _sine(record: np.ndarray, hertz: float, dt: float) -> np.ndarray:
    """The sine near a frequency that explains most of a record (T,), a drift beside it; zeros in a short one."""
    time = dt * np.arange(len(record))
    if len(record) < 8 * (DRIFT + 3):
        return np.zeros(len(record))
    drift = np.vander(np.linspace(-1.0, 1.0, len(record)), DRIFT + 1)
    tried = list[tuple[float, np.ndarray]]()
    for one in hertz + LINE_HZ * np.linspace(-1.0, 1.0, 21):
        angle = 2.0 * np.pi * one * time
        columns = np.column_stack([np.cos(angle), np.sin(angle), drift])
        size = np.linalg.lstsq(columns, record, rcond=None)[0]
        tried.append((float(((record - columns @ size) ** 2).sum()), columns[:, :2] @ size[:2]))
    return min(tried, key=lambda pair: pair[0])[1]


def _pilot_acts(dataset: Dataset, names: Sequence[str], spectra: Spectra) -> bool:
    """Whether a control or a rate moves in the quiet parts by more than a little of what it moves later."""
    for channel in (*dataset.controls, *(r for r in RATES if all(dataset.facts[n].has(r) for n in names))):
        moved = [_quiet_blocks(dataset, n, [channel], spectra).std() for n in names]
        if max(moved) > SETTINGS.still * max(dataset.scales()[channel], 1e-300):
            return True
    return False


def _between(means: np.ndarray) -> np.ndarray:
    """Mean square by channel of what is neither a flight's own drift nor common to all flights."""
    drift = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, means.shape[1]), DRIFT + 1))[0]
    deviations = means - means.mean(axis=0)
    deviations = deviations - np.einsum("bk,ck,fcn->fbn", drift, drift, deviations)
    return (deviations**2).sum(axis=(0, 1)) / _freedom(means.shape)


def _freedom(shape: tuple[int, ...]) -> int:
    """Independent values [flight, block] beyond each flight's own drift and what is common to all."""
    return max((shape[0] - 1) * (shape[1] - DRIFT - 1), 1)


def _critical_ratio(freedom: int, alarms: float) -> float:
    """Ratio that noise alone exceeds with this probability: chi-square over its degrees of freedom."""
    from scipy.special import chdtri  # slow to import

    return float(chdtri(freedom, alarms)) / freedom


def _visible(
    response: Mapping[str, float], noise: np.ndarray, channels: Sequence[str], critical: float
) -> tuple[float, str] | None:
    """Gusts that would show in the accelerometer that they shake most beside its noise."""
    least = noise * math.sqrt(max(critical - 1.0, 0.0))
    sizes = [b / response[c] for b, c in zip(least, channels, strict=True) if response.get(c, 0.0) > 0.0]
    return (min(sizes), "m/s") if sizes else None


def _vibration(dataset: Dataset, spec: ModelSpec) -> EffectFinding:
    lacking = registered()[VIBRATION].untestable(spec)
    if lacking is not None or spec.rotor is None:
        return finding(VIBRATION, Row(testable=False), lacking=lacking or "the rotor speed is not declared")
    values: dict[str, tuple[float, float]] = {}
    largest, where = 0.0, ""
    for channel in (*SPECIFIC_FORCES, *RATES):
        strength, hertz = _lines(dataset, channel, spec.rotor.speed / (2.0 * math.pi), 2 * spec.rotor.blades)
        ratio = strength / dataset.noise(channel) if dataset.noise(channel) > 0.0 else 0.0
        if ratio > largest:
            largest, where = ratio, f"{channel} at {hertz:.3g} Hz"
        if ratio > 1.0:
            name = f"{VIBRATION}.{'rates' if channel in RATES else 'accelerations'}"
            values[name] = (max(strength, values.get(name, (0.0, 0.0))[0]), 0.0)
    said = f"lines at multiples of the rotor speed stand above the sensors' noise, {where} most" if values else NO_LINE
    visible = dataset.noise(SPECIFIC_FORCES[2]), "m/s2"
    one = finding(VIBRATION, Row(significant=bool(values)), said)
    return replace(one, statistic=largest, critical_value=1.0, smallest_visible=visible, values=values)


def _lines(dataset: Dataset, channel: str, turn: float, most: int) -> tuple[float, float]:
    """Strongest line of a channel at a multiple of the rotor's speed: rms and frequency; zeros without one."""
    if not all(dataset.facts[n].has(channel) for n in dataset.identify):
        return 0.0, 0.0
    records = [dataset.flights[n].bridged([channel])[:, 0].numpy() for n in dataset.some(100)]
    hertz, power = spectrum(records, dataset.facts[dataset.identify[0]].dt)
    multiples = ((line, round(line.hertz / turn)) for line in lines(hertz, power))
    some = [line for line, k in multiples if 1 <= k <= most and abs(line.hertz - turn * k) <= LINE_HZ]
    strongest = max(some, key=lambda line: line.rms, default=None)
    return (0.0, 0.0) if strongest is None else (strongest.rms, strongest.hertz)
