"""Where the cause of what has no name lies: equation, band, what it goes with and how, since when. Never a name.

A step goes with a control where that one's own deflection would move every equation so: a control that loses its place.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from rotorid_torch.core.least_squares import least_squares
from rotorid_torch.core.names import FLAPPING, FORCES, MOMENTS
from rotorid_torch.model.gusts import GUSTS
from rotorid_torch.model.model import Model
from rotorid_torch.trace.evidence.fits import Flights
from rotorid_torch.trace.evidence.residual import (
    AT_ONCE,
    MOVED,
    SECOND_ORDER,
    TIME,
    LeftOver,
    loads,
    on_measured,
)
from rotorid_torch.trace.evidence.screen import PATH
from rotorid_torch.trace.evidence.unattributed import Description, Residuals, Shape
from rotorid_torch.trace.search.words import path_words, unknown_words
from rotorid_torch.trace.terms.candidate import UNATTRIBUTED
from rotorid_torch.trace.terms.finding import Unknown
from rotorid_torch.trace.terms.settings import SETTINGS
from rotorid_torch.trace.terms.significance import exceeds, share_at_least

Deflected = Mapping[str, Mapping[str, float]]
"""What each control does to each equation, per unit."""


def localised(
    significant: Sequence[Description], residuals: Residuals, does: Deflected, usual: Mapping[str, float] | None = None
) -> Unknown:
    """What these descriptions come to; the flapping first, for what moves the disc moves the body.

    Where other equations say the same, the cause lies in the angle of the disc that goes with it most, or in the
    largest moment. What begins with a step, the step aside, is described beside it.

    does : what each control does to the equations; a step that one of them makes by itself goes with that one. usual :
    size of T by equation where nothing is missing; without, the equations of a helicopter are compared in SI units.
    """
    size = lambda one: one.statistic / (usual or {}).get(one.row, 1.0)  # noqa: E731
    best = max(significant, key=lambda one: (one.row in FLAPPING, one.row in AT_ONCE, size(one)))
    others = _beside(best, residuals) if best.regressor.signal == TIME else None
    # a moment with much else in it is not significant by itself
    rows = [r for r in residuals.fitted.rows if r in MOMENTS or r in {one.row for one in significant}]
    same = [d for row in rows if exceeds((d := residuals.of(row, best.regressor)).evidence)]
    row = _source(best, [best, *(d for d in same if d.row != best.row)], residuals.fitted)
    left = residuals.fitted
    where = AT_ONCE.get(row, row)
    goes_with, shape, since_s = (others or best).regressor
    if since_s is not None and goes_with != TIME and not _begins(best, residuals):
        since_s = None
    if goes_with == TIME:
        control = slipped(row, since_s or 0.0, left, residuals.unseen or left, does)
        goes_with, shape = (goes_with, shape) if control is None else (control, "a step that it would make")
    band = _band(left.residual[:, left.rows.index(row)], left.rate)
    rms = _size(left, row, [best] if others is None else [best, others])
    unit = "m/s2" if where in FORCES else "rad/s2" if where in MOMENTS else "rad/s"
    missing = Unknown(where, band, goes_with, since_s, "")
    how = " and a step" if others else shape
    return replace(missing, sentence=unknown_words(missing, f"{rms:.2g}", unit, how, left.largest(row)))


def in_control_path(flights: Flights) -> Unknown:
    """Something acts between the recorded controls and the rotor, as fast as the controls move."""
    dataset = flights.dataset
    dt = dataset.facts[dataset.identify[0]].dt
    records = [dataset.flights[name].bridged(dataset.controls) for name in dataset.identify]
    band = _band(torch.cat([(record - record.mean(dim=0)).mT.flatten() for record in records]), 1.0 / dt)
    return Unknown(PATH.removeprefix(UNATTRIBUTED), band, None, None, path_words(band))


def _source(best: Description, same: Sequence[Description], left: LeftOver) -> str:
    """The row, of those that say the same as the best, where the cause lies."""
    if best.row in MOMENTS and left.inertia is not None:  # what yaws the body may roll it too, which answers louder
        inertia = dict(zip(MOMENTS, left.inertia.tolist(), strict=True))
        turning = [one for one in same if one.row in inertia]
        return max(turning, key=lambda one: inertia[one.row] * _size(left, one.row, [one])).row
    if _equation(best) in FLAPPING:  # a law that is wrong in one angle says the same of all
        angles = dict.fromkeys(_equation(one) for one in same if _equation(one) in FLAPPING)
        tilts = {angle: _of_tilt(best, angle, left) for angle in angles}
        angle = max(tilts, key=lambda angle: tilts[angle])
        if tilts[angle] >= SETTINGS.tilt:
            of_angle = [one for one in same if _equation(one) == angle]
            return max(of_angle, key=lambda one: (one.row in AT_ONCE, one.statistic)).row
    return best.row


def _beside(step: Description, residuals: Residuals) -> Description | None:
    """What begins with a step: what slips loses its place, and a part of its motion.

    The best description of the equation once the step is set aside, where that begins with the step.
    """
    onset = step.regressor.since_s or 0.0
    descriptions = residuals.less_beginning(onset, signals=False).descriptions()
    best = max((one for one in descriptions.values() if one.row == step.row), key=lambda one: one.statistic)
    since_s = best.regressor.since_s
    together = since_s is not None and abs(since_s - onset) <= residuals.fitted.onset_s
    return best if together and exceeds(best.evidence) else None


def _begins(one: Description, residuals: Residuals) -> bool:
    """Whether most of what goes otherwise with the motion later in a flight begins at the onset of a description.

    With everything linear set aside that begins there, no other onset must explain as much. What swings by itself, from
    the start, goes otherwise with the motion at any time.
    """
    onset = one.regressor.since_s or 0.0
    aside = residuals.less_beginning(onset, signals=True).descriptions()
    others = [other for other in aside.values() if other.row == one.row and Shape.of(other.regressor) is Shape.ONSET]
    return all(share_at_least(one.evidence, other.evidence) >= SETTINGS.adequate for other in others)


def _column(one: Description, left: LeftOver) -> Tensor:
    """What a description goes with [N]."""
    return Residuals(left).columns([one.regressor])[1][0][:, 0]


def _size(left: LeftOver, row: str, descriptions: Sequence[Description]) -> float:
    """Rms that descriptions explain together of what an equation leaves over."""
    k = left.rows.index(row)
    columns = torch.stack([_column(one, left) for one in descriptions], dim=-1)
    basis = torch.linalg.qr(left.beyond(columns, k)).Q
    return float((basis.mT @ left.residual[:, k]).norm()) / len(basis) ** 0.5


def _equation(one: Description) -> str:
    return AT_ONCE.get(one.row, one.row)


def _of_tilt(one: Description, angle: str, left: LeftOver) -> float:
    """Share of the square of a measured angle of the disc that goes with a description."""
    constants = left.constants
    both = torch.stack([_column(one, left), left.tilts[:, FLAPPING.index(angle)]], dim=-1)
    x, y = (both - constants @ least_squares(constants, both)).mT
    return float((x @ y) ** 2 / ((x @ x) * (y @ y)).clamp_min(1e-300))


def _band(values: Tensor, rate: float) -> tuple[float, float]:
    """Frequencies between which the middle 80 % of the power of a record [N] lie, Hz."""
    power = torch.fft.rfft(values - values.mean()).abs().square()
    share = power.cumsum(0) / power.sum().clamp_min(1e-300)
    hertz = torch.fft.rfftfreq(len(values), 1.0 / rate, dtype=torch.float64)
    low, high = (float(hertz[int((share >= s).nonzero()[0, 0])]) for s in (0.1, 0.9))
    return low, high


def deflected(model: Model) -> Deflected:
    """What a model's controls do at its reference: forces, moments, and the rates of a disc that follows them."""
    controls = [n for n in model.body.controls if n not in GUSTS]
    one = MOVED * torch.eye(len(controls), dtype=torch.float64)
    moved = dict(zip(controls, torch.cat([one, -one]).mT, strict=True))
    still = torch.zeros(2 * len(controls), dtype=torch.float64)
    signals = {n: moved.get(n, still) + model.reference.get(n, 0.0) for n in (*model.layout.names, *controls)}
    frame = on_measured(model, signals, {SECOND_ORDER: 0.0})
    change = dict(zip((*FORCES, *MOMENTS), loads(frame).mT, strict=True))
    change |= {row: frame.rates[n] for row, n in AT_ONCE.items() if n in frame.rates}
    up, down = torch.stack([*change.values()], dim=1).chunk(2)
    slopes = ((up - down) / (2.0 * MOVED)).tolist()
    return {control: dict(zip(change, slope, strict=True)) for control, slope in zip(controls, slopes, strict=True)}


def slipped(row: str, onset: float, left: LeftOver, unseen: LeftOver, does: Deflected) -> str | None:
    """The one control whose deflection makes all steps that begin at an onset, on unseen flights too; or None.

    row : where the step stands. On the disc's own motion the body says nothing of the rotor's controls: their work is
    the disc's; and where the disc follows its controls, the disc says nothing of the others.
    """
    rows = tuple(AT_ONCE) if row in (*FLAPPING, *AT_ONCE) else (*FORCES, *MOMENTS)
    here, confirmed = (_likeness(rows, onset, side, does) for side in (left, unseen))
    alike = [control for control in here if here[control] ** 2 >= SETTINGS.slipped]
    again = [c for c in alike if here[c] * confirmed.get(c, 0.0) > 0.0 and confirmed[c] ** 2 >= SETTINGS.slipped]
    return again[0] if alike == again and len(again) == 1 else None


def _likeness(rows: Sequence[str], onset: float, side: LeftOver, does: Deflected) -> dict[str, float]:
    """Cosine between the steps in these equations, each beside its own rest, and those that each control makes."""
    after = (side.time[:, None] >= onset).to(torch.float64)
    steps, units = [], []
    moved = dict(zip(side.rows, side.residual.any(dim=0).tolist(), strict=True))
    equations = [row for row in rows if moved.get(row) and all(row in response for response in does.values())]
    for row in equations:
        k = side.rows.index(row)
        tried, signals = side.beyond(torch.cat([after, side.residual[:, k, None]], dim=1), k).mT
        size = (tried @ signals) / (tried @ tried).clamp_min(1e-300)
        units.append(tried.norm() / (signals - size * tried).norm().clamp_min(1e-300))
        steps.append(size * units[-1])
    if len(equations) < 2:  # one equation is like any control
        return {}
    observed, unit = torch.stack(steps), torch.stack(units)
    directions = {
        c: torch.tensor([response[row] for row in equations], dtype=torch.float64) * unit
        for c, response in does.items()
    }
    return {
        c: float(torch.nn.functional.cosine_similarity(observed, one, dim=0, eps=1e-300))
        for c, one in directions.items()
    }
