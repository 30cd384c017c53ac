"""What stays without a name: told where it stands above its floor and holds on flights that no fit has seen.

Equation, band, what it goes with and how, since when. Never a name.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import torch
from torch import Tensor

from rotorid_torch.core.least_squares import least_squares
from rotorid_torch.core.names import FLAPPING, FORCES, MOMENTS
from rotorid_torch.trace.finding import Unknown
from rotorid_torch.trace.floor import FALSE_ALARMS
from rotorid_torch.trace.residual import (
    AT_ONCE,
    ONSET_S,
    TIME,
    LeftOver,
    Trace,
    by_chance,
    chance,
    column,
    less_steps,
    scan,
)
from rotorid_torch.trace.slips import Deflected, slipped

HELD = 0.5
"""Part of what a trace should explain of unseen flights, by its size and the rest where it was found, that it must."""

MAIN = 0.2
"""Share of what linear terms leave over of an equation that a trace must describe: less is one of many imperfections.

Slipped controls and products of the flight-test aircraft and another simulator's undeclared cause describe 0.31 to
0.66; the trace of a simulator with nothing undeclared that stands 3 % above its floor 0.10.
"""


def unknown(
    traces: Mapping[str, Trace],
    floors: Mapping[str, float],
    left: LeftOver,
    unseen: LeftOver,
    seed: int = 0,
    does: Deflected = MappingProxyType({}),
) -> Unknown | None:
    """The equation best described by its trace, of those that stand above their floors, flapping first; or None.

    traces, floors : by equation and kind. Where others that unseen flights confirm say the same, it is told of the
    angle of the disc that itself goes with it most, or of the largest moment. A trace describes a fair part of what its
    equation leaves over.
    Flights that no fit has seen must be better described with the trace as it was found, by more than chance allows and
    half as well as it should be there: the best of hundreds of traces that mean nothing explains less. A step that a
    straight line in time describes better is no step but a drift, which motion that dies away leaves over too.

    does : what each control does to the equations. A step that one of them makes by itself is told of that one.
    """
    above = [
        trace
        for key, trace in traces.items()
        if trace.row in unseen.rows and trace.weight > floors.get(key, math.inf) and trace.share >= MAIN
        if trace.goes_with != TIME or trace.share > _drift(trace.row, left)
    ]
    standing = [trace for trace in above if _holds(trace, left, unseen, seed)]
    if not standing:
        return None
    best = max(standing, key=_sure)
    beside = _beside(best, left, unseen, seed) if best.goes_with == TIME else None
    told = [best, beside] if beside else [best]
    # a moment with much else in it is described too little to stand by itself
    same = [t for t in traces.values() if t.named == best.named and (t in standing or t.row in MOMENTS)]
    same = [t for t in same if t is best or _shows(best, t.row, left, unseen, seed)]
    row, found = _source(best, same, left), beside or best
    where, band, size = AT_ONCE.get(row, row), _band(left, row), _size(left, row, told)
    unit = "m/s2" if where in FORCES else "rad/s2" if where in MOMENTS else "rad/s"
    control = slipped(row, found.since_s or 0.0, left, unseen, does) if found.goes_with == TIME else None
    if control is not None:
        found = replace(found, goes_with=control, shape="a step that it would make")
    how = " and a step" if beside else f" ({found.shape})" if found.shape else ""
    began = "" if found.since_s is None else f", since {found.since_s:.1f} s into the flights"
    said = (
        f"Something is missing in {where}: {size:.2g} {unit} rms at {band[0]:.2g} to {band[1]:.2g} Hz go with"
        f" {found.goes_with}{how}{began}; no effect of the library explains it."
    )
    return Unknown(where, band, found.goes_with, found.since_s, said)


def _source(best: Trace, same: Sequence[Trace], left: LeftOver) -> str:
    """The row, of those that say the same as the best, where it comes from."""
    if best.row in MOMENTS and left.inertia is not None:  # what yaws the body may roll it too, which answers louder
        inertia = dict(zip(MOMENTS, left.inertia.tolist(), strict=True))
        turning = [trace for trace in same if trace.row in inertia]
        return max(turning, key=lambda trace: inertia[trace.row] * trace.size).row
    if _equation(best) in FLAPPING:  # a law that is wrong in one angle says the same of all
        angles = dict.fromkeys(_equation(trace) for trace in same if _equation(trace) in FLAPPING)
        tilts = {angle: _of_tilt(best, angle, left) for angle in angles}
        angle = max(tilts, key=lambda angle: tilts[angle])
        if tilts[angle] >= MAIN:  # a controller may hold the disc where it was, and no angle goes with what acts
            return max((trace for trace in same if _equation(trace) == angle), key=_sure).row
    return best.row


def _shows(trace: Trace, row: str, left: LeftOver, unseen: LeftOver, seed: int) -> bool:
    """Whether unseen flights confirm by more than chance, of an equation too, a trace of another."""
    return row in unseen.rows and _holds(replace(trace, row=row), left, unseen, seed, 0.0)


def _less(step: Trace, side: LeftOver) -> LeftOver:
    assert step.since_s is not None
    return less_steps(side, step.since_s)


def _drift(row: str, left: LeftOver) -> float:
    """Share of what linear terms leave over of an equation that goes with time in a straight line, in all flights."""
    k = left.rows.index(row)
    line, rest = left.beyond(torch.stack([left.time, left.residual[:, k]], dim=-1), k).mT
    return _in_common(line, rest)


def _beside(step: Trace, left: LeftOver, unseen: LeftOver, seed: int) -> Trace | None:
    """What begins with a step: what slips loses its place, and a part of its motion.

    That something began, and is not ordinary, is known by the step. With what it goes is told where, the step aside,
    the best of all descriptions begins with it, is more than chance makes of the rest and a fair part of it, and takes
    more than chance from flights that no fit has seen, however little they move it.
    """
    less, onset = _less(step, left), step.since_s or 0.0
    best = max((trace for trace in scan(less).values() if trace.row == step.row), key=lambda trace: trace.size)
    if best.since_s is None or abs(best.since_s - onset) > ONSET_S or best.share < MAIN:
        return None
    above = best.weight > float(chance(less, seed)[best.key].quantile(1.0 - FALSE_ALARMS))
    return best if above and _holds(best, less, _less(step, unseen), seed, 0.0) else None


def _size(left: LeftOver, row: str, traces: Sequence[Trace]) -> float:
    """Rms that traces explain together of what an equation leaves over."""
    k = left.rows.index(row)
    columns = torch.stack([column(trace, left, left.usual) for trace in traces], dim=-1)
    basis = torch.linalg.qr(left.beyond(columns, k)).Q
    return float((basis.mT @ left.residual[:, k]).norm()) / len(basis) ** 0.5


def _sure(trace: Trace) -> tuple[bool, bool, float]:
    """What moves the disc moves the body; surest is what the disc's own angles cannot take up."""
    return trace.row in FLAPPING, trace.row in AT_ONCE, trace.share


def _equation(trace: Trace) -> str:
    return AT_ONCE.get(trace.row, trace.row)


def _of_tilt(trace: Trace, angle: str, left: LeftOver) -> float:
    """Share of the square of a measured angle of the disc that goes with a trace."""
    constants = left.constants
    both = torch.stack([column(trace, left, left.usual), left.tilts[:, FLAPPING.index(angle)]], dim=-1)
    x, y = (both - constants @ least_squares(constants, both)).mT
    return _in_common(x, y)


def _in_common(x: Tensor, y: Tensor) -> float:
    """Share of the square of either [N] that the other describes."""
    return float((x @ y) ** 2 / ((x @ x) * (y @ y)).clamp_min(1e-300))


def _holds(trace: Trace, left: LeftOver, unseen: LeftOver, seed: int, part: float = HELD) -> bool:
    """Whether flights that no fit has seen lose enough by a trace of the size that `left` gave it.

    Each side keeps linear terms of its own. More than the same trace takes from the residuals turned in time by chance.
    Flights that excite it less than those it was found on have less to lose beside the rest, which all flights have;
    those that hardly excite it can confirm nothing.
    """
    k = left.rows.index(trace.row)
    tried, known = left.beyond(torch.stack([column(trace, left, left.usual), left.residual[:, k]], dim=-1), k).mT
    size = (tried @ known) / (tried @ tried)
    new = size * unseen.beyond(column(trace, unseen, left.usual)[:, None], k)[:, 0]
    residuals = torch.cat([unseen.residual[:, k, None], by_chance(unseen, seed)[:, k]], dim=-1)
    before = unseen.beyond(residuals, k)
    lost = 2.0 * new @ before - new @ new
    rest = (known - size * tried).square().mean() * len(new)
    share = float((new @ new) / (new @ new + rest).clamp_min(1e-300))
    enough = part * max(share, MAIN) * before[:, 0].square().sum()
    return bool(lost[0] > torch.maximum(lost[1:].quantile(1.0 - FALSE_ALARMS), enough))


def _band(left: LeftOver, row: str) -> tuple[float, float]:
    """Frequencies between which the middle 80 % of a residual's power lie, Hz."""
    values = left.residual[:, left.rows.index(row)]
    power = torch.fft.rfft(values - values.mean()).abs().square()
    share = power.cumsum(0) / power.sum().clamp_min(1e-300)
    hertz = torch.fft.rfftfreq(len(values), 1.0 / left.rate, dtype=torch.float64)
    low, high = (float(hertz[int((share >= s).nonzero()[0, 0])]) for s in (0.1, 0.9))
    return low, high
