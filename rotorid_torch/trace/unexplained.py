"""What stays without a name: told where it stands above clean aircraft and holds on flights that no fit has seen.

Equation, band, what it goes with and how, since when. Never a name.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch

from rotorid_torch.core.names import FORCES
from rotorid_torch.trace.finding import Unknown
from rotorid_torch.trace.residual import LeftOver, Trace, column
from rotorid_torch.trace.significance import helps

HELD = 0.5
"""Share of what a trace explains of the flights it was found on that it must explain of unseen ones."""


def unknown(
    traces: Mapping[str, Trace], floors: Mapping[str, float], left: LeftOver, unseen: LeftOver
) -> Unknown | None:
    """The equation whose trace stands highest above what clean aircraft leave; None where none does.

    Flights that no fit has seen must be better described with the trace as it was found, and as well as those it was
    found on, or nearly: the best of hundreds of traces that mean nothing explains less of them.
    """
    above = {row: t.weight / floors[row] for row, t in traces.items() if floors.get(row, 0.0) > 0.0}
    standing = [row for row, times in above.items() if times > 1.0 and _holds(traces[row], row, left, unseen)]
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


def _holds(trace: Trace, row: str, left: LeftOver, unseen: LeftOver) -> bool:
    """Whether flights that no fit has seen gain by a trace, of the size that the flights `left` gave it.

    Each side keeps linear terms of its own.
    """
    k = left.rows.index(row)
    (tried, known), (new, before) = (
        side.beyond(torch.stack([column(trace, side, left.usual), side.residual[:, k]], dim=-1), k).unbind(-1)
        for side in (left, unseen)
    )
    after = before - (tried @ known) / (tried @ tried) * new
    flights = [unseen.flight == f for f in unseen.flight.unique()]
    gains = [(before[own].square().sum() / after[own].square().sum()).log() for own in flights]
    share = 1.0 - float(after.square().sum() / before.square().sum())
    return helps(torch.stack(gains)) and share > HELD * trace.share


def _band(left: LeftOver, row: str) -> tuple[float, float]:
    """Frequencies between which the middle 80 % of a residual's power lie, Hz."""
    values = left.residual[:, left.rows.index(row)]
    power = torch.fft.rfft(values - values.mean()).abs().square()
    share = power.cumsum(0) / power.sum().clamp_min(1e-300)
    hertz = torch.fft.rfftfreq(len(values), 1.0 / left.rate, dtype=torch.float64)
    low, high = (float(hertz[int((share >= s).nonzero()[0, 0])]) for s in (0.1, 0.9))
    return low, high
