"""Controls whose record is late: the response seems to come before its input, which no vehicle does."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorid_torch.consistency.pairs.precedence import Following, fast_responses, responses
from rotorid_torch.consistency.sensor_pairs import Agreement, agreement, stick_pairs
from rotorid_torch.core.statistics import weighted_mean
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

EARLY_S = 0.01
"""Smallest time by which a response must precede its control to be told; its stick, twice that."""
SURE_STICKS, SURE = 3.0, 4.0
"""Standard errors beyond which a response precedes: rates against sticks, accelerations against controls."""
SEEN, FOLLOWED = 0.6, 0.7
"""R² from which on a rate is compared with its stick, and from which on what is recorded commands the response."""
SHARPEST_S = 1e-4
"""Least standard error of a lag: it is interpolated between steps a hundred times as long."""


@dataclass(frozen=True)
class LateControls:
    """Time by which the record of the controls is late at least, s, with its standard error.

    At least: what the vehicle takes to respond comes on top, and cannot be told from these streams. sticks : rates that
    come before their sticks. accelerations : those that come before the controls; one of the two is empty.
    """

    seconds: float
    se: float
    sticks: tuple[Agreement, ...] = ()
    accelerations: tuple[Following, ...] = ()

    @property
    def clearest(self) -> str:
        """The response that says it most surely."""
        pairs = [(a.pair.left_name, a.lag_s, a.lag_se) for a in self.sticks]
        pairs += [(r.acceleration, r.lag_s, r.lag_se) for r in self.accelerations]
        return min(pairs, key=lambda pair: pair[1] + SURE * pair[2])[0]


def followed_sticks(dataset: Dataset) -> tuple[Agreement, ...]:
    """Rates that follow their sticks closely enough for a lag, in the identify flights."""
    flights = [dataset.flights[name] for name in dataset.identify]
    agreements = (agreement(pair, flights) for pair in stick_pairs(dataset))
    return tuple(a for a in agreements if a is not None and a.r2 > SEEN)


def known_responses(dataset: Dataset) -> tuple[Following, ...]:
    """Accelerations whose lag behind the controls is known."""
    return tuple(r for r in responses(dataset) if r.r2 > 0.5 and r.gain > 0.1 and r.lag_se < 0.02)


def late_controls(dataset: Dataset) -> LateControls | None:
    """Whether responses precede their controls, beyond chance, beyond a sample, and in no flight the other way round.

    Where rates follow sticks, these are compared directly and their mean is told; otherwise accelerations, and of these
    the one that leaves least time for the vehicle to respond. It comes first with slow motion and without it, and what
    is told is the shorter: a load that swings turns the vehicle before the controller that answers. Flights too short
    to be looked at without slow motion tell nothing. A stick that commands an attitude is not late: the
    rate leads it, for it goes with the stick's own rate of change. Nor is what a controller moves against the rate.
    """
    sticks = followed_sticks(dataset)
    if sticks:
        flights = [dataset.flights[name] for name in dataset.identify]
        first = tuple(a for a in sticks if a.r2 > FOLLOWED and _precedes(a, _sample(dataset)))
        answered = _answered(dataset) if first else ()
        early = tuple(a for a in first if a.pair.left_name not in answered and not _commands_attitude(a, flights))
        return _mean(early) if early else None
    first = [r for r in coming_first(dataset, known_responses(dataset)) if r.r2 > FOLLOWED]
    fast = {r.channel: r for r in coming_first(dataset, fast_responses(dataset))} if first else {}
    felt = tuple(max(r, fast[r.channel], key=lambda one: one.lag_s) for r in first if r.channel in fast)
    if not felt:
        return None
    least = min(felt, key=lambda r: r.lag_s + SURE * r.lag_se)
    return LateControls(-least.lag_s, least.lag_se, accelerations=felt)


def coming_first(dataset: Dataset, responses: Sequence[Following]) -> tuple[Following, ...]:
    """Those of a data set's responses that precede their controls, by more than chance and more than a sample."""
    return tuple(r for r in responses if r.lag_s < -max(SURE * r.lag_se, EARLY_S, _sample(dataset)))


def _sample(dataset: Dataset) -> float:
    """The longest interval of the records, s."""
    return max(dataset.facts[name].dt for name in dataset.identify)


def _precedes(a: Agreement, sample: float) -> bool:
    follows = any(lag > SURE_STICKS * se for lag, se in a.lags_s.values())
    return a.lag_s < -max(SURE_STICKS * a.lag_se, 2.0 * EARLY_S, sample) and not follows


def _answered(dataset: Dataset) -> tuple[str, ...]:
    """Rates whose acceleration clearly follows the controls beside the states: what follows the rate is feedback."""
    follow = (r for r in responses(dataset) if r.gain > 0.1 and r.lag_s > max(SURE * r.lag_se, 2.0 * EARLY_S))
    return tuple(r.channel for r in follow)


def _commands_attitude(a: Agreement, flights: Sequence[Flight]) -> bool:
    """Whether the rate goes with the stick's rate of change rather than with the stick."""
    stick = a.pair.right
    moving = replace(a.pair, right=lambda flight: np.gradient(stick(flight), flight.dt))
    moved = agreement(moving, flights)
    return moved is not None and moved.r2 >= a.r2


def _mean(early: tuple[Agreement, ...]) -> LateControls:
    return LateControls(
        *weighted_mean([-a.lag_s for a in early], [max(a.lag_se, SHARPEST_S) for a in early]), sticks=early
    )
