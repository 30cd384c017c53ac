"""Does the response follow its control? By how much, and not the other way round, as misaligned streams make it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rotorid_torch.core import names
from rotorid_torch.data.consistency import REACH_S, SAMPLED_S, STEP_S, jackknife_error, kernel, pieces
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Array = np.ndarray

WIDTH_S = 0.04
"""Standard deviation of the Gaussian that all signals pass, in s: half power at 3.3 Hz, no phase."""
LAGS_S = np.linspace(-REACH_S, REACH_S, round(2 * REACH_S / STEP_S) + 1)


@dataclass(frozen=True)
class Response:
    """By how many seconds an acceleration follows the controls (negative: precedes them), with its standard error.

    r2 : share of its variance that the controls at that lag and the states explain; gain : how much more that is than
    with the controls 0.4 s away, where nothing but slow motion is left.
    """

    channel: str
    lag_s: float
    lag_se: float
    r2: float
    gain: float


def responses(dataset: Dataset) -> tuple[Response, ...]:
    """How each angular acceleration and the vertical specific force follow the controls in the identify flights.

    Sums of linear terms: all controls, shifted by one lag, and the body's rates and velocities where they are
    measured. The states stand for what feeds back into blade angles and motor commands; without them a controller's
    answer to the rate would count as its cause.
    """
    found = (_response(dataset, channel) for channel in (*names.RATES, "az"))
    return tuple(response for response in found if response is not None)


def _response(dataset: Dataset, channel: str) -> Response | None:
    flights = [dataset.flights[name] for name in dataset.identify if dataset.facts[name].has(channel)]
    states = [c for c in (*names.RATES, *names.VELOCITIES) if all(f.has(c) for f in flights)]
    if channel == "az":
        states = [c for c in states if c in names.VELOCITIES]
    parts = [moments for f in flights for moments in _moments(f, channel, dataset.controls, states)]
    if not parts:
        return None
    total = np.sum(parts, axis=0)
    r2 = np.array([_r2(moments) for moments in total])
    error = jackknife_error([_top(np.array([_r2(m) for m in total - part])) for part in parts])
    if len(parts) < 2 or r2.max() <= 0.0:
        return None
    return Response(channel, _top(r2), error, float(r2.max()), float(r2.max() - max(r2[0], r2[-1])))


def _moments(flight: Flight, channel: str, controls: tuple[str, ...], states: list[str]) -> Iterator[Array]:
    """Cross moments (lags, columns, columns) of each piece: the response, the controls at the lag, the states."""
    bell, slope = kernel(flight.dt, WIDTH_S)
    reach = int(np.ceil(REACH_S / flight.dt)) + 1
    if flight.samples < len(bell) + 2 * reach + 50:
        return
    columns = flight.bridged([channel, *controls, *states]).numpy().T
    left = np.convolve(columns[0], bell if channel == "az" else slope, "valid")
    rest = np.stack([np.convolve(column, bell, "valid") for column in columns[1:]])
    step = max(1, int(SAMPLED_S / flight.dt))
    for first, last in pieces(len(left), flight.dt, reach):
        here = np.arange(first, last, step)
        moved, at = rest[: len(controls), first - reach : last + reach], np.arange(last - first + 2 * reach)
        fixed = np.concatenate([left[None, here], rest[len(controls) :, here]])
        made = []
        for lag in LAGS_S:
            shifted = np.stack([np.interp(here - first + reach - lag / flight.dt, at, row) for row in moved])
            all_columns = np.concatenate([fixed, shifted])
            centred = all_columns - all_columns.mean(axis=1, keepdims=True)
            made.append(centred @ centred.T)
        yield np.array(made)


def _r2(moments: Array) -> float:
    """Share of the first column's variance that the others explain."""
    normal, slope = moments[1:, 1:], moments[1:, 0]
    scale = np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    if moments[0, 0] <= 0.0:
        return 0.0
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-9, hermitian=True)
    return float(slope / scale @ inverse @ (slope / scale) / moments[0, 0])


def _top(r2: Array) -> float:
    """Lag of the best agreement, by a parabola through the best three."""
    best = int(np.argmax(r2))
    if best in (0, len(r2) - 1):
        return float(LAGS_S[best])
    below, at, above = r2[best - 1 : best + 2]
    bend = below - 2.0 * at + above
    return float(LAGS_S[best] + (0.5 * STEP_S * (below - above) / bend if bend < 0.0 else 0.0))
