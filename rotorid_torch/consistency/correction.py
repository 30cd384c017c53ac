"""Records with sensor errors taken out: clocks moved, lags undone, constants, scales, mounting and place corrected."""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import torch

from rotorid_torch.consistency.equations import undoing, unit_of, without_static_errors
from rotorid_torch.consistency.smoothing import advanced, kernel
from rotorid_torch.core.names import RATES, SPECIFIC_FORCES, is_control
from rotorid_torch.core.rigid import specific_force_at
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.schema import ChannelSpec

Array = np.ndarray

TURNING_S = 0.03
"""Width of the Gaussian by which rates are differentiated for the lever arm: half power at 4.4 Hz."""


def without_errors(dataset: Dataset, errors: Mapping[str, float]) -> Dataset:
    """The data set with these errors ("delay.attitude", "scale.q", ...) removed from every flight.

    What a moved clock leaves without a reading is missing. Declared noise follows: a channel whose lag is undone has
    up to twice the noise power, one behind a filter of second order three times.
    """
    corrected = dataset.changed(lambda flight: without_errors_of_flight(flight, errors))
    return replace(corrected, channel_specs=MappingProxyType(_noise(dataset, errors)))


def _noise(dataset: Dataset, errors: Mapping[str, float]) -> dict[str, ChannelSpec]:
    specs = dict(dataset.channel_specs)
    for name, spec in specs.items():
        if spec.noise is not None:
            first, second = undoing(errors, unit_of(name))
            lagged = (1.0 + (first > 0.0) + (second != 0.0)) ** 0.5
            noise = float(spec.noise * lagged) / (1.0 + errors.get(f"scale.{name}", 0.0))
            specs[name] = ChannelSpec(noise=noise, bias=spec.bias)
    return specs


def without_errors_of_flight(flight: Flight, errors: Mapping[str, float]) -> Flight:
    """The same for one flight."""
    x = {name: _on_time(flight, name, errors) for name in flight.channels if _unit(name) or name.endswith("dot")}
    x = without_static_errors(x, errors)
    arm = torch.tensor([errors.get(f"lever_arm.{axis}", 0.0) for axis in "xyz"], dtype=torch.float64)
    if arm.any() and all(name in x for name in RATES):
        rates, turning = (
            torch.from_numpy(np.stack(rows, axis=-1))
            for rows in zip(*((x[name], _slope(x[name], flight.dt, TURNING_S)) for name in RATES), strict=True)
        )
        felt = specific_force_at(arm, torch.zeros_like(rates), rates, turning).numpy()
        x |= {name: x[name] - felt[:, i] for i, name in enumerate(SPECIFIC_FORCES) if name in x}
    channels = {**flight.channels, **{name: torch.from_numpy(np.ascontiguousarray(v)) for name, v in x.items()}}
    return Flight(flight.name, flight.dt, MappingProxyType(channels))


def _unit(name: str) -> str:
    """Channels that share a clock: a sensor's, or the controls."""
    return "controls" if is_control(name) else unit_of(name)


def _on_time(flight: Flight, name: str, errors: Mapping[str, float]) -> Array:
    values, unit = flight.channels[name].numpy(), _unit(name)
    delay, (first, second) = errors.get(f"delay.{unit}", 0.0), undoing(errors, unit)
    if delay:
        margin = int(np.ceil(abs(delay) / flight.dt)) + 3
        values = advanced(np.pad(values, margin, constant_values=np.nan), delay / flight.dt, margin)
    added = []
    # each window as narrow as keeps the added noise no greater than the sensor's own
    if first > 0.0:
        width = max((first**2 * flight.dt / (4.0 * np.pi**0.5)) ** (1 / 3), 0.6 * flight.dt)
        added.append(first * _slope(values, flight.dt, width))
    if second:
        width = max((3.0 * second**2 * flight.dt / (8.0 * np.pi**0.5)) ** (1 / 5), 0.6 * flight.dt) / 2.0**0.5
        added.append(second * _slope(_slope(values, flight.dt, width), flight.dt, width))
    return values + sum(added) if added else values


def _slope(values: Array, dt: float, width: float) -> Array:
    """Rate of change (T,) of a record through a Gaussian of this width, s; straight lines continue beyond the ends.

    Missing samples are bridged, and missing again in what comes out.
    """
    measured = np.flatnonzero(~np.isnan(values))
    if len(measured) < 4:
        return np.full_like(values, np.nan)
    filled = np.interp(np.arange(len(values)), measured, values[measured])
    slope = kernel(dt, width)[1]
    first, last, half = measured[0], measured[-1] + 1, len(slope) // 2
    if last - first <= half:
        return np.where(np.isnan(values), np.nan, np.gradient(filled, dt))
    out = np.full_like(values, np.nan)
    out[first:last] = np.convolve(np.pad(filled[first:last], half, mode="reflect", reflect_type="odd"), slope, "valid")
    return np.where(np.isnan(values), np.nan, out)
