"""One flight: channels on one uniform time grid, immutable; knows no vehicle."""

from __future__ import annotations

import copyreg
import html
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.data.use.pictures import of_channels
from rotorid_torch.data.use.tables import frame

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Flight:
    """Channels of one flight, each (T,) float64, SI units and radians; NaN is a missing sample; "time" starts at 0."""

    name: str
    dt: float
    channels: Mapping[str, Tensor]

    @property
    def time(self) -> Tensor:
        """Time (T,) in s from the first sample."""
        return self.channels["time"]

    @property
    def samples(self) -> int:
        """Number of samples T."""
        return self.time.shape[0]

    def __repr__(self) -> str:
        seconds = self.dt * (self.samples - 1)
        return f"Flight {self.name}: {seconds:.4g} s at {1.0 / self.dt:.4g} Hz; {', '.join(self.channels)}"

    def __getitem__(self, channel: str | Sequence[str]) -> Tensor:
        """A channel (T,), or several of a list as columns (T, n).

        Raises
        ------
        KeyError : there is none; with those there are.
        """
        if isinstance(channel, list | tuple):
            return torch.stack([self[name] for name in channel], dim=-1)
        if not isinstance(channel, str) or channel not in self.channels:
            raise KeyError(f"flight {self.name} has no channel '{channel}', but {', '.join(self.channels)}")
        return self.channels[channel].clone()  # what is done to it leaves the flight as it is

    def __iter__(self) -> Iterator[str]:
        return iter(self.channels)

    def __contains__(self, channel: object) -> bool:
        return channel in self.channels

    def to_numpy(self) -> dict[str, np.ndarray]:
        """All channels by name, each (T,)."""
        return {name: values.numpy().copy() for name, values in self.channels.items()}

    def to_pandas(self) -> Any:
        """All channels as a DataFrame over the time in s; InputError where pandas is not installed."""
        return frame(self.to_numpy(), index="time")

    def plot(self, channels: Sequence[str] | None = None) -> Figure:
        """Channels over time as a matplotlib figure; all that are not empty by default.

        Raises
        ------
        InputError : a channel that there is not.
        """
        filled = [name for name in self.channels if name != "time" and self.has(name)]
        shown = (
            filled if channels is None else arguments.names(Argument("plot", "channels"), channels, filled, "channel")
        )
        return of_channels(self.name, self.channels, shown)

    def _repr_html_(self) -> str:
        """The same as `repr`, for a notebook."""
        return f"<p>{html.escape(repr(self))}</p>"

    def has(self, *names: str) -> bool:
        """Whether every one of these channels is there and not all NaN."""
        return all(name in self.channels and not bool(self.channels[name].isnan().all()) for name in names)

    def stack(self, names: Sequence[str]) -> Tensor:
        """Channels as columns (T, n); NaN where the flight has no such channel."""
        missing = torch.full((self.samples,), torch.nan, dtype=torch.float64)
        if not names:
            return missing.new_empty(self.samples, 0)
        return torch.stack([self.channels.get(name, missing) for name in names], dim=-1)

    def bridged(self, names: Sequence[str]) -> Tensor:
        """Channels as columns (T, n) with missing samples bridged linearly and held at the ends.

        A simulation needs its controls like this.
        """
        return bridged(self.stack(names))

    def stretches(self, names: Sequence[str], least: float = 0.0) -> Tensor:
        """Number (T,) of the stretch without a gap of any of these channels that a sample lies in; -1 in a gap.

        A gap is longer than two of the channel's usual intervals, and than `least` seconds.
        """
        inside = bridged_but_gaps(self.stack(names), round(least / self.dt)).isnan().any(dim=-1).long()
        begins = torch.diff(inside, prepend=torch.ones_like(inside[:1])) < 0
        return torch.where(inside > 0, -1, begins.cumsum(0) - 1)

    def arrays(
        self, controls: Sequence[str], outputs: Sequence[str], x0: Sequence[float] | Tensor | None = None
    ) -> dict[str, Any]:
        """The flight as `output_error` and `filter_error` take flights.

        controls, outputs : channels that become columns; missing samples of controls are bridged linearly.
        x0 : the initial state; absent where it is None.

        Raises
        ------
        InputError : a channel that there is not.
        """
        filled = [name for name in self.channels if name != "time" and self.has(name)]
        chosen = [
            arguments.names(Argument("arrays", key), names, filled, "channel")
            for key, names in (("controls", controls), ("outputs", outputs))
        ]
        arrays = {"time": self["time"], "controls": self.bridged(chosen[0]), "outputs": self.stack(chosen[1])}
        return arrays if x0 is None else {**arrays, "x0": x0}

    def lead(self, seconds: float = 0.5) -> slice:
        """Samples before `seconds`; at least one."""
        return slice(0, max(1, int((self.time < seconds).sum())))


def read_only(channels: dict[str, Any]) -> MappingProxyType[str, Any]:
    """What nobody changes; it can be copied and pickled, as data sets are for other processes."""
    return MappingProxyType(channels)


copyreg.pickle(MappingProxyType, lambda mapping: (read_only, (dict(mapping),)))


def bridged(columns: Tensor) -> Tensor:
    """Columns (T, n) with missing samples bridged linearly and held at the ends; those of none stay missing."""
    columns = columns.clone()
    for column in columns.T:
        column.copy_(_bridge(column))
    return columns


def bridged_but_gaps(columns: Tensor, least: int) -> Tensor:
    """Columns (T, n) with missing samples bridged linearly, but those in gaps.

    A gap is longer than `least` samples and than two of the channel's usual intervals, so that what lies between two
    samples of a slow channel is none.
    """
    columns, whole = columns.clone(), bridged(columns)
    for column, without in zip(columns.T, whole.T, strict=True):
        column.copy_(torch.where(_gaps(column, least), column, without))
    return columns


def _gaps(column: Tensor, least: int) -> Tensor:
    """Which samples [T] lie in a gap."""
    samples = np.flatnonzero(~column.isnan().numpy())
    usual = np.median(np.diff(samples)) if len(samples) > 1 else len(column)
    spans = np.diff(samples, prepend=-1, append=len(column))  # from one sample to the next
    inside = np.repeat(spans - 1 > max(least, 2.0 * usual), spans)
    return torch.from_numpy(inside[: len(column)]) & column.isnan()


def _bridge(column: Tensor) -> Tensor:
    missing = column.isnan().numpy()
    if not missing.any() or missing.all():
        return column
    values, samples = column.numpy().copy(), np.flatnonzero(~missing)
    values[missing] = np.interp(np.flatnonzero(missing), samples, values[samples])
    return torch.from_numpy(values)
