"""What is known of a flight without its samples: taken once, when it is read, so that it need not stay in memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from rotorid_torch.core import names
from rotorid_torch.data.flight import Flight


@dataclass(frozen=True, slots=True)
class Spread:
    """One channel of one flight: its mean over the first 0.5 s, and what it does about that.

    start : that mean; the first sample there is, where all of these are missing. count : samples that are there.
    total, squares : sums of (sample - start) and of its square. low, high : least and largest sample. rests : whether
    the samples of the first 0.5 s are all the same.
    """

    start: float
    count: int
    total: float
    squares: float
    low: float
    high: float
    rests: bool

    def mean(self) -> float:
        """Mean over the record."""
        return self.start + self.total / self.count

    def squares_about(self, level: float) -> float:
        """Sum of (sample - level)²."""
        away = self.start - level
        return self.squares + 2.0 * away * self.total + self.count * away**2


@dataclass(frozen=True)
class Facts:
    """Sample interval in s, number of samples, all channels, and the spread of those with any sample."""

    dt: float
    samples: int
    channels: tuple[str, ...]
    spreads: Mapping[str, Spread] = field(repr=False)

    @classmethod
    def of(cls, flight: Flight) -> Facts:
        """Take them from a flight."""
        lead = flight.lead()
        spreads = {name: _spread(values.numpy(), lead) for name, values in flight.channels.items()}
        measured = {name: spread for name, spread in spreads.items() if spread is not None}
        return cls(flight.dt, flight.samples, tuple(flight.channels), measured)

    @property
    def seconds(self) -> float:
        """From the first sample to the last."""
        return (self.samples - 1) * self.dt

    def has(self, *channels: str) -> bool:
        """Whether every one of these channels is there and not all NaN."""
        return all(name in self.spreads for name in channels)

    def lack(self, name: str) -> str:
        """How a channel that has no sample is lacking, and which one of another name may be meant by it."""
        near = [f"'{c}'" for c in self.channels if names.channel(c) is None and names.meant(c) == name]
        hint = f" ({', '.join(near)} is there, a name that nothing knows)" if near else ""
        return "is all NaN" if name in self.channels else f"is missing{hint}"


def _spread(values: np.ndarray, lead: slice) -> Spread | None:
    present = values[~np.isnan(values)]
    if not len(present):
        return None
    first = values[lead]
    first = first[~np.isnan(first)]
    start = float(first.mean()) if len(first) else float(present[0])
    away = present - start
    rests = not len(first) or bool(first.min() == first.max())
    sums = float(away.sum()), float(away @ away)
    return Spread(start, len(present), *sums, float(present.min()), float(present.max()), rests)
