"""Raw arrays to a Flight: checked, unwrapped, on a uniform time grid."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch

from rotorid_torch.core.ranges import of_channel
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.plausible import without_impossible
from rotorid_torch.data.reading.held import without_held, without_repeats
from rotorid_torch.data.reading.marks import without_marks
from rotorid_torch.data.reading.read import Arrays
from rotorid_torch.data.reading.spikes import without_spikes
from rotorid_torch.data.reading.suspicion import beyond_half_a_turn
from rotorid_torch.errors import InputError, nearest

UNIFORM = 0.01
"""Largest deviation of an interval from the median interval, relative, that still counts as uniform."""
GAP_S = 0.02
"""An interval longer than this and than 2.5 samples is a gap: a tenth of the period of 5 Hz, beyond which a straight
line is no longer what the aircraft did."""
INTERVALS_S = (1e-5, 2.0)
"""Shortest and longest usual interval of a flight record; beyond them time is not in seconds."""
LONGEST_GAP = 100_000
"""Samples that a flight may lack besides four times those it has; a longer pause makes two flights."""


def make_flight(
    name: str, arrays: Arrays, file: str | Path, units: Mapping[str, str] | None = None
) -> tuple[Flight, list[str]]:
    """Flight from raw arrays, and sentences on what had to be changed.

    `file` is named in errors. `units` are those of the controls, rad for sticks by default. Raises InputError.
    """
    checked = _check_shapes(arrays, file)
    _check_time(checked["time"], file)
    _check_finite(checked, file)
    checked = _within_half_a_turn(checked)
    checked, marked = without_marks(checked, units)
    checked, cleaned = _without_impossible(checked, units or {}, file)
    checked, spiky = without_spikes(checked)
    checked, held = without_held(checked)
    checked = without_repeats(checked)
    for angle in ("phi", "psi"):
        if angle in checked:
            checked[angle] = unwrap(checked[angle])
    dt, resampled, warnings = resample(checked)
    tensors = {channel: torch.from_numpy(np.ascontiguousarray(values)) for channel, values in resampled.items()}
    remarks = [f"flight {name}: {sentence}" for sentence in (*marked, *cleaned, *spiky, *held, *warnings)]
    return Flight(name, dt, MappingProxyType(tensors)), remarks


def _check_shapes(arrays: Arrays, file: str | Path) -> Arrays:
    if "time" not in arrays:
        raise InputError(file, "time", "is missing", f"time in s{nearest('time', arrays)}")
    samples = len(arrays["time"])
    for channel, values in arrays.items():
        if len(values) != samples:
            raise InputError(file, channel, f"has {len(values)} samples", f"{samples} as in time")
    if samples < 2:
        raise InputError(file, "time", f"has {samples} sample{'' if samples == 1 else 's'}", "a time history")
    return {channel: np.array(values, dtype=np.float64) for channel, values in arrays.items()}


def _check_time(time: np.ndarray, file: str | Path) -> None:
    bad = ~np.isfinite(time)
    if bad.any():
        raise InputError(
            file, "time", f"is {time[bad][0]} at sample {int(bad.argmax())}", "a finite time for every sample"
        )
    allowed = of_channel("time").samples
    if outside := [float(t) for t in (time[0], time[-1]) if not allowed.holds(float(t))]:
        raise InputError(file, "time", f"reaches {outside[0]:.4g} s", str(allowed))
    steps = np.diff(time)
    if (steps <= 0).any():
        at = int((steps <= 0).argmax()) + 1
        what = "repeats" if steps[at - 1] == 0 else "runs backwards"
        wrong = f"{what} at sample {at} ({time[at - 1]:.9g} s, then {time[at]:.9g} s)"
        raise InputError(file, "time", wrong, "strictly increasing time")
    typical = float(np.median(steps))
    if not INTERVALS_S[0] <= typical <= INTERVALS_S[1]:
        wanted = f"time in s, with samples {INTERVALS_S[0]:g} to {INTERVALS_S[1]:g} s apart"
        raise InputError(file, "time", f"has samples {typical:.4g} s apart", wanted)
    if time[-1] - time[0] > (4 * len(time) + LONGEST_GAP) * typical:
        at = int(steps.argmax())
        raise InputError(
            file, "time", f"jumps by {steps[at]:.4g} s at sample {at + 1}", "one flight without long pauses"
        )


def _check_finite(arrays: Arrays, file: str | Path) -> None:
    for channel, values in arrays.items():
        infinite = np.isinf(values)
        if infinite.any():
            wrong = f"is infinite at sample {int(infinite.argmax())}"
            raise InputError(file, channel, wrong, "finite numbers, or NaN for a missing sample")


def _within_half_a_turn(arrays: Arrays) -> Arrays:
    """Arrays with angles that are counted from zero, or a roll angle that goes on turning as its rate says, wrapped."""
    if "time" not in arrays:
        return arrays
    records = {name: (arrays["time"], values) for name, values in arrays.items()}
    listed = beyond_half_a_turn(records, records.get("p"))
    return arrays | {name: (arrays[name] + np.pi) % (2.0 * np.pi) - np.pi for name in listed}


def _without_impossible(arrays: Arrays, units: Mapping[str, str], file: str | Path) -> tuple[Arrays, list[str]]:
    """Channels without the samples that no aircraft has, and a sentence on each that had any."""
    possible, sentences = dict(arrays), []
    for channel, values in arrays.items():
        allowed = of_channel(channel, units.get(channel, "")).samples
        possible[channel], sentence = without_impossible(channel, values, allowed, file, channel)
        sentences += [sentence] if sentence else []
    return possible, sentences


def unwrap(angle: np.ndarray) -> np.ndarray:
    """Angle (T,) in rad without jumps of 2 pi, over missing samples too."""
    present = ~np.isnan(angle)
    result = angle.copy()
    result[present] = np.unwrap(angle[present])
    return result


def resample(arrays: Arrays) -> tuple[float, Arrays, list[str]]:
    """Put channels on a uniform grid from 0.

    They stay as they are where time is uniform within 1 %, else they are interpolated linearly; gaps and NaN stay NaN.
    Returns the time step, the channels and sentences on what was changed.
    """
    time = arrays["time"] - arrays["time"][0]
    steps = np.diff(time)
    typical = float(np.median(steps))
    samples = len(time)
    dt = float(time[-1]) / (samples - 1)
    drift = np.abs(time - dt * np.arange(samples)).max()
    if np.abs(steps - typical).max() <= UNIFORM * typical * 1.0001 and drift <= 0.5 * dt:
        return dt, {**arrays, "time": dt * np.arange(samples)}, []
    return _interpolate(arrays, time, steps, typical)


def _interpolate(
    arrays: Arrays, time: np.ndarray, steps: np.ndarray, typical: float
) -> tuple[float, Arrays, list[str]]:
    count = max(1, round(float(time[-1]) / typical))
    dt = float(time[-1]) / count
    grid = dt * np.arange(count + 1)
    gap = steps > max(GAP_S, 2.5 * typical)
    interval = np.clip(np.searchsorted(time, grid, side="right") - 1, 0, len(steps) - 1)
    inside = gap[interval] & (grid > time[interval]) & (grid < time[interval + 1])
    result = {channel: np.where(inside, np.nan, np.interp(grid, time, values)) for channel, values in arrays.items()}
    result["time"] = grid
    warnings = [
        f"time is not uniform (intervals {steps.min():.4g} to {steps.max():.4g} s, median {typical:.4g} s): "
        f"resampled linearly to {dt:.6g} s"
    ]
    if gap.any():
        warnings.append(
            f"{int(gap.sum())} gap{'s' if gap.sum() > 1 else ''} of up to {steps.max():.3g} s stay missing samples"
        )
    return dt, result, warnings
