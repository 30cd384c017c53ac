"""What stays without a name: told where it stands above clean aircraft and holds on flights that no fit has seen.

Equation, band, what it goes with and how, since when. Never a name.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from rotorid_torch.core.names import FORCES
from rotorid_torch.trace.finding import Unknown
from rotorid_torch.trace.residual import RATE, LeftOver, Trace, column
from rotorid_torch.trace.significance import helps


def unknown(
    traces: Mapping[str, Trace], floors: Mapping[str, float], left: LeftOver, unseen: LeftOver
) -> Unknown | None:
    """The equation whose trace stands highest above what clean aircraft leave; None where none does.

    Flights that no fit has seen must be better described with the trace as it was found.
    """
    above = {row: t.weight / floors[row] for row, t in traces.items() if floors.get(row, 0.0) > 0.0}
    standing = [row for row, times in above.items() if times > 1.0 and helps(_held_up(traces[row], row, left, unseen))]
    if not standing:
        return None
    where = max(standing, key=lambda row: above[row])
    found, unit = traces[where], "m/s2" if where in FORCES else "rad/s2"
    band = _band(left, where)
    how = f" ({found.shape})" if found.shape else ""
    began = "" if found.since_s is None else f", since {found.since_s:.1f} s into the flights"
    said = (
        f"Something is missing in {where}: {found.size:.2g} {unit} rms at {band[0]:.2g} to {band[1]:.2g} Hz go with"
        f" {found.goes_with}{how}{began}; no effect of the library explains it."
    )
    return Unknown(where, band, found.goes_with, found.since_s, said)


def _held_up(trace: Trace, row: str, left: LeftOver, unseen: LeftOver) -> Tensor:
    """log(rms without / rms with a trace) of the residual of each flight that no fit has seen [F].

    The trace has the size that the flights `left` gave it; each side keeps linear terms of its own.
    """
    k = left.rows.index(row)
    (tried, known), (new, before) = (
        (side.beyond(column(trace, side, left.usual)[:, None])[:, 0], side.beyond(side.residual)[:, k])
        for side in (left, unseen)
    )
    after = before - (tried @ known) / (tried @ tried) * new
    flights = [unseen.flight == f for f in unseen.flight.unique()]
    gains = [0.5 * (before[own].square().sum() / after[own].square().sum()).log() for own in flights]
    return torch.stack(gains)


def _band(left: LeftOver, row: str) -> tuple[float, float]:
    """Frequencies between which the middle 80 % of a residual's power lie, Hz."""
    values = left.residual[:, left.rows.index(row)]
    power = torch.fft.rfft(values - values.mean()).abs().square()
    share = power.cumsum(0) / power.sum().clamp_min(1e-300)
    hertz = torch.fft.rfftfreq(len(values), 1.0 / RATE, dtype=torch.float64)
    low, high = (float(hertz[int((share >= s).nonzero()[0, 0])]) for s in (0.1, 0.9))
    return low, high
