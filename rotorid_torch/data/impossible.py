"""Samples that no aircraft has: missing samples from reading on, or an error where they are many."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from rotorid_torch.core.ranges import Range
from rotorid_torch.errors import InputError

FEW = 0.01
"""Share of a channel's samples that may be impossible; where there are more, the unit or the sensor is wrong."""


def without_impossible(
    channel: str, values: np.ndarray, allowed: Range, file: str | Path, key: str
) -> tuple[np.ndarray, str]:
    """Samples (T,) of a channel with those outside the range as NaN, and a sentence; empty where there are none.

    `file` and `key` are named in errors.

    Raises
    ------
    InputError : where more than one, and more than `FEW` of the samples, lie outside, or half of them.
    """
    measured = int((~np.isnan(values)).sum())
    outside = (values < allowed.low) | (values > allowed.high)
    count = int(outside.sum())
    if not count:
        return values, ""
    worst = float(values[outside][np.abs(values[outside]).argmax()])
    reaches, many = f"reaches {worst:.4g} {allowed.unit}".rstrip(), "1 sample" if count == 1 else f"{count} samples"
    if count > max(1, FEW * measured) or 2 * count >= measured:
        guess = "degrees, or another unit?" if allowed.unit.startswith("rad") else "another unit?"
        text = f"{reaches}, {count} of {measured} samples outside {allowed} ({guess})"
        raise InputError(file, key, text, f"{allowed}, but for {FEW:.0%} of the samples")
    return np.where(
        outside, math.nan, values
    ), f"{channel} {reaches}: {many} outside {allowed} taken as missing samples"
