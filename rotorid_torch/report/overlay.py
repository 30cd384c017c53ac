"""What pictures of a run show: free runs beside measured flights, spectra of the error, evidence of candidates."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from torch import Tensor

from rotorid_torch.core import names
from rotorid_torch.report.records import EffectRecord

LEAST, MOST = 1e-2, 1e4
"""Ratios of statistics and critical values beyond these are drawn there."""


@dataclass(frozen=True)
class Overlay:
    """A free run, or a multirotor's accelerations at measured states, beside what was measured.

    Attributes
    ----------
    flight, list : name of the flight and of the list it is in.
    time : (T,) s.
    measured, model : channels by name, each (T,) in its unit; a channel that one side lacks is not drawn.
    controls : as recorded, by name, each (T,). units : of controls. noise : standard deviation of a sample, by channel.
    band : standard deviation of the model by the errors of its parameters, by channel, each (T,).
    without : what the model does where one of its effects does nothing, by effect and channel, each (T,).
    integrated : whether it is a free run; else the model is evaluated at measured states.
    """

    flight: str
    list: str
    time: Tensor = field(repr=False)
    measured: Mapping[str, Tensor] = field(repr=False)
    model: Mapping[str, Tensor] = field(repr=False)
    controls: Mapping[str, Tensor] = field(default_factory=dict, repr=False)
    units: Mapping[str, str] = field(default_factory=dict, repr=False)
    noise: Mapping[str, float] = field(default_factory=dict, repr=False)
    band: Mapping[str, Tensor] = field(default_factory=dict, repr=False)
    without: Mapping[str, Mapping[str, Tensor]] = field(default_factory=dict, repr=False)
    integrated: bool = True

    def common(self, channels: Sequence[str]) -> list[str]:
        """Those of `channels` that both sides have, measured at one sample at least."""
        both = [name for name in channels if name in self.measured and name in self.model]
        return [name for name in both if not bool(self.measured[name].isnan().all())]


def over_floor(effects: Sequence[EffectRecord]) -> list[tuple[EffectRecord, float]]:
    """Candidates that were tested, with statistic over critical value, largest first."""
    tested = [e for e in effects if e.gain is not None and e.floor and e.verdict != "not testable"]
    ranked = [(e, min(max(e.ratio, LEAST), MOST)) for e in tested]
    return sorted(ranked, key=lambda pair: -pair[1])


def mean_spectra(overlays: Sequence[Overlay]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Frequencies in Hz and amplitudes of what is left over, by channel; a mean over flights not used to fit."""
    channels = dict.fromkeys(c for _, c in unseen_channels(overlays))
    chosen = [c for c in names.BODY if c in channels] or list(channels)[:6]
    means = {channel: _mean_spectrum(overlays, channel) for channel in chosen}
    return {channel: mean for channel, mean in means.items() if mean is not None}


def _mean_spectrum(overlays: Sequence[Overlay], channel: str) -> tuple[np.ndarray, np.ndarray] | None:
    each = [spectrum(o, channel) for o, c in unseen_channels(overlays) if c == channel]
    if not each:
        return None
    length = min(len(power) for _, power in each)
    mean = np.sqrt(np.mean([power[:length] for _, power in each], axis=0))
    hertz = each[0][0][:length]
    edges = np.unique(np.geomspace(1, max(length, 2), 120).astype(int))
    groups = [slice(a, b) for a, b in pairwise(edges)]
    return np.array([hertz[g].mean() for g in groups]), np.array([mean[g].mean() for g in groups])


def spectrum(overlay: Overlay, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz, and power of the error per line."""
    error = (overlay.measured[name] - overlay.model[name]).nan_to_num(0.0).numpy()
    window = np.hanning(len(error) + 1)[:-1]
    step = float(overlay.time[1] - overlay.time[0])
    power = np.abs(np.fft.rfft(error * window)) ** 2 * 2.0 / (window.sum() ** 2)
    return np.fft.rfftfreq(len(error), step), power


def unseen_channels(overlays: Sequence[Overlay]) -> Iterator[tuple[Overlay, str]]:
    """Flights that no fit has seen with their channels."""
    return scored_channels(overlay for overlay in overlays if overlay.list != "identify")


def scored_channels(overlays: Iterable[Overlay]) -> Iterator[tuple[Overlay, str]]:
    """Flights with their channels: those that are scored, or accelerations."""
    for overlay in overlays:
        for channel in overlay.common(names.BODY if overlay.integrated else tuple(overlay.measured)):
            yield overlay, channel


def rms(values: np.ndarray) -> float:
    """Root mean square of what is not missing (NaN); zero where all is."""
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else 0.0
