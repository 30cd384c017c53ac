"""Pictures of a report: the one that shows what was discovered, what each effect explains, evidence and spectra."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from markupsafe import Markup

from rotorid_torch.core import names
from rotorid_torch.report.figures import Overlay
from rotorid_torch.report.loop_figures import over_floor, spectrum
from rotorid_torch.report.page.svg import Bar, Line, Panel, chart, stacked
from rotorid_torch.report.records import EffectRecord, FitRecord
from rotorid_torch.report.short_horizon import short_horizon
from rotorid_torch.report.summary import weakest_channel
from rotorid_torch.report.words.effects import words_of

WINDOW_S = 5.0
"""Length of what is shown of a long record: there the lines can be told apart."""
CHANNELS_OF_AN_EFFECT = 2
NOTHING = 0.003
"""Part of a channel's motion by which its error must fall to be called a gain."""
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
    """A picture with its caption."""

    image: Markup
    caption: str


def main_picture(before: Sequence[Overlay], after: Sequence[Overlay], fit: FitRecord | None = None) -> Picture | None:
    """The flight and channel that gain most; those described worst where none gains. Flights not used to fit, if any.

    fit : says which responses of a multirotor do not count, for a flight leaves them alone or the model has none;
    where none counts the picture shows that.
    """
    earlier = {overlay.flight: overlay for overlay in before}
    unseen = [overlay for overlay in after if overlay.list != "identify"]
    every = list(_scored(unseen or after))
    judged = [(overlay, channel) for overlay, channel in every if _counts(fit, overlay.flight, channel)] or every
    if not judged:
        return None
    gains = [_gain(overlay, earlier.get(overlay.flight), channel) for overlay, channel in judged]
    gained = bool(earlier) and max(gains) > NOTHING
    if earlier and not gained:
        gains = [_gain(overlay, None, channel) for overlay, channel in judged]
    chosen = judged[gains.index(max(gains))]
    overlay, channel = chosen if gained else _weakest(fit, judged) or chosen
    other, part = earlier.get(overlay.flight), _window(overlay, channel)
    time, measured = overlay.time.numpy()[part], overlay.measured[channel].numpy()[part]
    models = [("after", overlay), *([("before", other)] if other is not None else [])]
    errors = [Line(kind, time, measured - o.model[channel].numpy()[part]) for kind, o in reversed(models)]
    lines = [
        Line("measured", time, measured),
        *(Line(k, time, o.model[channel].numpy()[part]) for k, o in models[::-1]),
    ]
    unit = names.unit(channel)
    panels = [
        *_control(overlay, part),
        Panel(f"{channel}, {unit}", lines, 130),
        Panel(f"measured - model, {unit}", errors, 70),
    ]
    how = "free run" if overlay.integrated else "at measured states"
    words = [("measured", "measured"), *([("before", "before")] if other is not None else []), ("after", "model")]
    change = f": the error falls from {_rms(errors[0].y):.2g} to {_rms(errors[-1].y):.2g} {unit} rms" if gained else ""
    why = "gains most" if gained else "is described worst; none gains" if other else "is described worst"
    fitted = "the model was made from" if overlay.list == "identify" else "no fit has seen"
    caption = (
        f"{_about(channel)} on {overlay.flight}, a flight that {fitted} ({how}). Of all channels this one"
        f" {why}{change}. Top: the control that moves most. Bottom: what the model leaves over."
    )
    alt = f"{channel} of {overlay.flight} over time, measured and modelled{change}"
    return Picture(stacked(panels, "time, s", alt, words), caption)


def _weakest(fit: FitRecord | None, judged: Sequence[tuple[Overlay, str]]) -> tuple[Overlay, str] | None:
    """The flight and channel that the first screen calls the worst, where those are drawn."""
    weakest = None if fit is None or short_horizon(fit) else weakest_channel(fit)
    return next((one for one in judged if weakest and (one[0].flight, one[1]) == weakest[:2]), None)


def _counts(fit: FitRecord | None, flight: str, channel: str) -> bool:
    response = fit.flights[flight].responses.get(channel) if fit and flight in fit.flights else None
    return response is None or (response.moved and response.described)


def effect_pictures(after: Sequence[Overlay], effects: Sequence[EffectRecord]) -> dict[str, Picture]:
    """For each effect in the model what is left over without it, and how much of that it explains."""
    pictures = {}
    for effect in effects:
        gains = [(_explained(o, effect.id, c), o, c) for o, c in _judged(after) if effect.id in o.without]
        if not gains or max(gains, key=lambda g: g[0])[0] <= 0.0:
            continue
        _, overlay, _ = max(gains, key=lambda g: g[0])
        channels = [c for g, o, c in sorted(gains, key=lambda g: -g[0]) if o is overlay and g > 0.0]
        pictures[effect.id] = _of_effect(overlay, effect.id, channels[:CHANNELS_OF_AN_EFFECT])
    return pictures


def _of_effect(overlay: Overlay, effect: str, channels: Sequence[str]) -> Picture:
    panels, part = [], _window(overlay, channels[0])
    time = overlay.time.numpy()[part]
    for channel in channels:
        bare = overlay.without[effect][channel].numpy()[part]
        left = Line("measured", time, overlay.measured[channel].numpy()[part] - bare)
        does = Line("after", time, overlay.model[channel].numpy()[part] - bare)
        panels.append(Panel(f"{channel}, {names.unit(channel)}", (left, does), 84))
    keys = [("measured", "left over without it"), ("after", "what it does")]
    caption = (
        f"{overlay.flight}: what the model leaves over without {words_of(effect).noun}, and what that explains of it."
    )
    return Picture(stacked([*_control(overlay, part), *panels], "time, s", caption, keys), caption)


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


def mean_spectra(overlays: Sequence[Overlay]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Frequencies in Hz and amplitudes of what is left over, by channel; a mean over flights not used to fit."""
    channels = dict.fromkeys(c for _, c in _judged(overlays))
    chosen = [c for c in names.BODY if c in channels] or list(channels)[:6]
    means = {channel: _mean_spectrum(overlays, channel) for channel in chosen}
    return {channel: mean for channel, mean in means.items() if mean is not None}


def _mean_spectrum(overlays: Sequence[Overlay], channel: str) -> tuple[np.ndarray, np.ndarray] | None:
    each = [spectrum(o, channel) for o, c in _judged(overlays) if c == channel]
    if not each:
        return None
    length = min(len(power) for _, power in each)
    mean = np.sqrt(np.mean([power[:length] for _, power in each], axis=0))
    hertz = each[0][0][:length]
    edges = np.unique(np.geomspace(1, max(length, 2), 120).astype(int))
    groups = [slice(a, b) for a, b in pairwise(edges)]
    return np.array([hertz[g].mean() for g in groups]), np.array([mean[g].mean() for g in groups])


def _judged(overlays: Sequence[Overlay]) -> Iterator[tuple[Overlay, str]]:
    """Flights that no fit has seen with their channels."""
    return _scored(overlay for overlay in overlays if overlay.list != "identify")


def _scored(overlays: Iterable[Overlay]) -> Iterator[tuple[Overlay, str]]:
    """Flights with their channels: those that are scored, or accelerations."""
    for overlay in overlays:
        for channel in overlay.common(names.BODY if overlay.integrated else tuple(overlay.measured)):
            yield overlay, channel


def _gain(overlay: Overlay, other: Overlay | None, channel: str) -> float:
    """How much of a channel's motion the error falls by; of one model the error itself."""
    spread = _rms(overlay.measured[channel].numpy() - np.nanmean(overlay.measured[channel].numpy())) or 1.0
    error = _rms((overlay.measured[channel] - overlay.model[channel]).numpy())
    if other is None:
        return error / spread
    if channel not in other.model:
        return -np.inf
    return (_rms((other.measured[channel] - other.model[channel]).numpy()) - error) / spread


def _explained(overlay: Overlay, effect: str, channel: str) -> float:
    """By how much of a channel's motion the error falls with an effect."""
    measured, bare = overlay.measured[channel], overlay.without[effect].get(channel)
    if bare is None:
        return 0.0
    spread = _rms((measured - measured.nanmean()).numpy()) or 1.0
    return (_rms((measured - bare).numpy()) - _rms((measured - overlay.model[channel]).numpy())) / spread


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


def _control(overlay: Overlay, part: slice) -> list[Panel]:
    """The control that moves most in a part of a flight."""
    shown = {n: values.numpy()[part] for n, values in overlay.controls.items()}
    moved = {n: float(np.nanstd(v)) for n, v in shown.items() if len(v) and np.isfinite(v).any()}
    if not moved:
        return []
    most = max(moved, key=lambda n: moved[n])
    values = shown[most]
    return [
        Panel(
            f"{most}, {overlay.units.get(most, '')}",
            [Line("control", overlay.time.numpy()[part][: len(values)], values)],
            48,
        )
    ]


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else 0.0


def _about(name: str) -> str:
    channel = names.channel(name)
    about = channel.about.partition(",")[0] if channel else name
    return f"{about[0].upper()}{about[1:]} ({name})" if about != name else name
