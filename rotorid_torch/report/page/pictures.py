"""Pictures of a report: the one that shows what was discovered, what each effect explains, evidence and spectra."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from markupsafe import Markup
from torch import Tensor

from rotorid_torch.core import names
from rotorid_torch.report.overlay import Overlay, mean_spectra, over_floor, rms, scored_channels, unseen_channels
from rotorid_torch.report.page.svg import Bar, Line, Panel, chart, stacked
from rotorid_torch.report.records import EffectRecord, FitRecord, UnknownRecord
from rotorid_torch.report.short_horizon import short_horizon, weakest_response
from rotorid_torch.report.summary import weakest_channel
from rotorid_torch.report.words.effects import words_of

WINDOW_S = 5.0
"""Length of what is shown of a long record: there the lines can be told apart."""
CHANNELS_OF_AN_EFFECT = 2
NOTHING = 0.003
"""Part of a channel's motion by which its error must fall to be called a gain."""
TOP = "the control that moves most beyond its usual motion"
_MOVED = dict(zip((*names.FORCES, *names.MOMENTS), (*names.VELOCITIES, *names.RATES), strict=True))
"""The channel that each equation moves."""
SIGNS = {
    "accepted": "✔ accepted",
    "indistinguishable": "≈ cannot be told apart",
    "suspected": "? suspected",
    "rejected": "✘ rejected",
    "below floor": "○ below floor",
    "absorbed": "□ absorbed by others",
    "not testable": "– not testable",
}
"""Verdicts with a sign, so that no colour carries the meaning alone."""


@dataclass(frozen=True)
class Picture:
    """A picture with its caption, and of what it is where that is a channel of a flight."""

    image: Markup
    caption: str
    flight: str = ""
    channel: str = ""


def main_picture(
    before: Sequence[Overlay],
    after: Sequence[Overlay],
    fit: FitRecord | None = None,
    unknown: UnknownRecord | None = None,
) -> Picture | None:
    """The flight and channel that gain most; those described worst where none gains. Flights not used to fit, if any.

    fit : says which responses of a multirotor do not count, for a flight leaves them alone or the model has none;
    where none counts the picture shows that. unknown : of the channel that its equation moves.
    """
    earlier, usual = {overlay.flight: overlay for overlay in before}, _usual(after)
    every = list(scored_channels([o for o in after if o.list != "identify"] or after))
    moved = [(o, c) for o, c in every if unknown is not None and c == _MOVED.get(unknown.where[:1])]
    judged = moved or [(o, c) for o, c in every if _counts(fit, o.flight, c)] or every
    if not judged:
        return None
    gains = [_gain(o, earlier.get(o.flight), c, usual[c]) for o, c in judged]
    gained = bool(earlier) and not moved and max(gains) > NOTHING
    if not gained:
        gains = [_gain(o, None, c, usual[c]) for o, c in judged]
    chosen = judged[gains.index(max(gains))]
    if not gained and not moved:
        chosen = _weakest(fit, every) or chosen
    why = Why.MISSING if moved else Why.GAINS if gained else Why.NONE_GAINS if earlier else Why.WORST
    return _of_channel(*chosen, earlier.get(chosen[0].flight), why, usual)


class Why(Enum):
    """Why a channel is the one that is shown."""

    GAINS = "Of all channels this one gains most"
    NONE_GAINS = "Of all channels this one is described worst; none gains"
    WORST = "Of all channels this one is described worst"
    MISSING = "What is missing acts on it, and is seen best here"


def _of_channel(overlay: Overlay, channel: str, other: Overlay | None, why: Why, usual: Mapping[str, float]) -> Picture:
    """A channel of a flight: a control, measured and modelled, what is left over; and why it is shown."""
    part, unit = _window(overlay, channel), names.unit(channel)
    time, measured = overlay.time.numpy()[part], overlay.measured[channel].numpy()[part]
    models = [*([("before", other)] if other is not None else []), ("after", overlay)]
    runs = [Line(kind, time, one.model[channel].numpy()[part]) for kind, one in models]
    errors = [Line(run.kind, time, measured - run.y) for run in runs]
    fall = f": the error falls from {rms(errors[0].y):.2g} to {rms(errors[-1].y):.2g} {unit} rms"
    reason = why.value + (fall if why is Why.GAINS else "")
    panels = [
        *_control(overlay, part, usual),
        Panel(f"{channel}, {unit}", [Line("measured", time, measured), *runs], 130),
        Panel(f"measured - model, {unit}", errors, 70),
    ]
    words = [("measured", "measured"), *([("before", "before")] if other is not None else []), ("after", "model")]
    caption = f"{_about(channel)} on {_which(overlay)}. {reason}. Top: {TOP}. Bottom: what the model leaves over."
    alt = f"{channel} of {overlay.flight} over time, measured and modelled. {reason}"
    return Picture(stacked(panels, "time, s", alt, words), caption, overlay.flight, channel)


def _which(overlay: Overlay) -> str:
    """A flight, and what the model has to do with it."""
    how = "free run" if overlay.integrated else "at measured states"
    fitted = "the model was made from" if overlay.list == "identify" else "no fit has seen"
    return f"{overlay.flight}, a flight that {fitted} ({how})"


def _weakest(fit: FitRecord | None, every: Sequence[tuple[Overlay, str]]) -> tuple[Overlay, str] | None:
    """The flight and channel that the first screen calls the worst, where those are drawn."""
    weakest = fit and (weakest_response(fit) if short_horizon(fit) else weakest_channel(fit))
    return next((one for one in every if weakest and (one[0].flight, one[1]) == weakest[:2]), None)


def _counts(fit: FitRecord | None, flight: str, channel: str) -> bool:
    response = fit.flights[flight].responses.get(channel) if fit and flight in fit.flights else None
    return response is None or (response.moved and response.described)


def effect_pictures(after: Sequence[Overlay], effects: Sequence[EffectRecord]) -> dict[str, Picture]:
    """For each effect in the model what is left over without it, and how much of that it explains."""
    pictures, usual = {}, _usual(after)
    for effect in effects:
        gains = [
            (_explained(o, effect.id, c, usual[c]), o, c) for o, c in unseen_channels(after) if effect.id in o.without
        ]
        if not gains or max(gains, key=lambda g: g[0])[0] <= 0.0:
            continue
        _, overlay, _ = max(gains, key=lambda g: g[0])
        first, *more = (c for _, o, c in sorted(gains, key=lambda g: -g[0]) if o is overlay)
        clear = [c for c in more if _halved(overlay, effect.id, c)][: CHANNELS_OF_AN_EFFECT - 1]
        pictures[effect.id] = _of_effect(overlay, effect.id, [first, *clear], usual)
    return pictures


def _of_effect(overlay: Overlay, effect: str, channels: Sequence[str], usual: Mapping[str, float]) -> Picture:
    panels, part = [], _window(overlay, channels[0])
    time = overlay.time.numpy()[part]
    for channel in channels:
        bare = overlay.without[effect][channel].numpy()[part]
        left = Line("measured", time, overlay.measured[channel].numpy()[part] - bare)
        does = Line("after", time, overlay.model[channel].numpy()[part] - bare)
        panels.append(Panel(f"{channel}, {names.unit(channel)}", (left, does), 100))
    keys = [("measured", "left over without it"), ("after", "what it does")]
    what = f"what the model leaves over without {words_of(effect).noun}, and what that explains of it"
    caption = f"{_which(overlay)}: {what}. Top: {TOP}."
    alt = f"{overlay.flight}: {what}"
    image = stacked([*_control(overlay, part, usual), *panels], "time, s", alt, keys)
    return Picture(image, caption, overlay.flight, channels[0])


def evidence(effects: Sequence[EffectRecord]) -> Picture | None:
    """Evidence of each candidate over its floor, largest first."""
    ranked = over_floor(effects)
    if not ranked:
        return None
    bars = [Bar(e.id, ratio, e.shown.replace(" ", "-"), SIGNS[e.shown][0]) for e, ratio in ranked]
    first = bars[0]
    alt = f"Evidence over floor of {len(bars)} effects. Largest: {first.name}, {first.value:.3g} times the floor."
    caption = (
        "Evidence of each effect over its floor. Right of the line it explains more than where nothing is missing."
        f" {', '.join(SIGNS[v] for v in dict.fromkeys(e.shown for e, _ in ranked))}."
    )
    return Picture(chart(bars, "evidence over floor", alt), caption)


def spectra(before: Sequence[Overlay], after: Sequence[Overlay]) -> Picture | None:
    """Amplitude of what is left over by frequency, mean over flights not used to fit, before and after."""
    models = [("before", before), ("after", after)] if before else [("after", after)]
    means = {kind: mean_spectra(some) for kind, some in models}
    panels = [
        Panel(f"{c}, {names.unit(c)}", [Line(k, *mean[c]) for k, mean in means.items() if c in mean], 60, log=True)
        for c in means["after"]
    ]
    if not panels:
        return None
    words = [("before", "before"), ("after", "after")] if before else [("after", "measured - model")]
    caption = (
        "Amplitude of what the model leaves over, by frequency, on flights that no fit has seen. A hump is missing"
        " dynamics, a line is vibration, a rise to the left a slow drift."
    )
    return Picture(stacked(panels, "frequency, Hz", caption, words), caption)


def _usual(overlays: Sequence[Overlay]) -> dict[str, float]:
    """What each channel and control moves about its mean, root mean square over all flights."""
    parts: dict[str, list[np.ndarray]] = {}
    for overlay in overlays:
        for name, values in (*overlay.measured.items(), *overlay.controls.items()):
            parts.setdefault(name, []).append((values - values.nanmean()).numpy())
    return {name: rms(np.concatenate(some)) or 1.0 for name, some in parts.items()}


def _gain(overlay: Overlay, other: Overlay | None, channel: str, usual: float) -> float:
    """How much of a channel's usual motion the error falls by; of one model the error itself."""
    error = _error(overlay.measured[channel], overlay.model[channel])
    if other is None:
        return error / usual
    if channel not in other.model:
        return -np.inf
    return (_error(other.measured[channel], other.model[channel]) - error) / usual


def _explained(overlay: Overlay, effect: str, channel: str, usual: float) -> float:
    """How much of a channel's usual motion the error falls by with an effect."""
    measured, bare = overlay.measured[channel], overlay.without[effect].get(channel)
    return 0.0 if bare is None else (_error(measured, bare) - _error(measured, overlay.model[channel])) / usual


def _halved(overlay: Overlay, effect: str, channel: str) -> bool:
    """Whether the effect explains half of what a channel leaves over without it, so that a picture shows it."""
    measured, bare = overlay.measured[channel], overlay.without[effect].get(channel)
    return bare is not None and _error(measured, overlay.model[channel]) < 0.5 * _error(measured, bare)


def _window(overlay: Overlay, channel: str) -> slice:
    """Where a long record moves most; all of a free run."""
    values = np.nan_to_num(overlay.measured[channel].numpy())
    if len(values) < 2:
        return slice(0, len(values))
    length = round(WINDOW_S / float(overlay.time[1] - overlay.time[0]))
    if overlay.integrated or length >= len(values):
        return slice(0, len(values))
    power = np.concatenate([[0.0], np.cumsum((values - values.mean()) ** 2)])
    first = int(np.argmax(power[length:] - power[:-length]))
    return slice(first, first + length)


def _control(overlay: Overlay, part: slice, usual: Mapping[str, float]) -> list[Panel]:
    """The control that moves most, over its usual motion, in a part of a flight."""
    shown = {n: values.numpy()[part] for n, values in overlay.controls.items()}
    moved = {n: float(np.nanstd(v)) / usual[n] for n, v in shown.items() if len(v) and np.isfinite(v).any()}
    if not moved:
        return []
    most = max(moved, key=lambda n: moved[n])
    line = Line("control", overlay.time.numpy()[part][: len(shown[most])], shown[most])
    return [Panel(f"{most}, {overlay.units.get(most, '')}", [line], 48)]


def _error(measured: Tensor, model: Tensor) -> float:
    return rms((measured - model).numpy())


def _about(name: str) -> str:
    about = names.about(name).partition(",")[0] or name
    return f"{about[0].upper()}{about[1:]} ({name})" if about != name else name
