"""A data set: vehicle, flights and their lists, validated once, read as needed; reference point, scales and noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.core import names
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.facts import Facts
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.on_demand import OnDemand
from rotorid_torch.data.reading.contents import SHOWN, Contents
from rotorid_torch.data.reading.noise import quiet_samples, white_noise
from rotorid_torch.data.reading.read import FOLDERS, find_flight
from rotorid_torch.data.reading.sources import from_document, from_folder
from rotorid_torch.data.schema import Vehicle
from rotorid_torch.data.use.tables import frame
from rotorid_torch.data.windows import Windows, windows_of
from rotorid_torch.errors import InputError
from rotorid_torch.printable import html_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NOISE_FLOOR = 1e-3
"""Least noise of a channel that declares none, as a share of its rms deviation: a filtered channel is not exact."""
ENOUGH = 100
"""Identify flights that a noise or a spectrum is estimated from, at most; more make it no more certain."""


@dataclass(frozen=True, eq=False, repr=False)
class Dataset(Contents):
    """Flights of one vehicle about one reference point. Made by `load` or `Dataset.from_arrays`, both validating."""

    @classmethod
    def from_arrays(
        cls,
        flights: Mapping[str, Mapping[str, Any]],
        *,
        identify: Sequence[str],
        validate: Sequence[str] = (),
        acid: Sequence[str] = (),
        kind: str = "helicopter",
        name: str = "arrays",
        description: str = "",
        vehicle: Mapping[str, Any] | Vehicle | None = None,
        controls: Mapping[str, Any] | None = None,
        channels: Mapping[str, Any] | None = None,
        model: Mapping[str, Any] | None = None,
    ) -> Dataset:
        """Data set from arrays in memory, with the validation of `load`.

        Parameters
        ----------
        flights : per flight its channels, each (T,) (NumPy, tensor or list), with "time" and at least one control.
        identify, validate, acid : names of the flights in each list.
        vehicle, controls, channels, model : tables as in dataset.toml, as dicts (or the structs of `data.schema`).

        Raises
        ------
        InputError : with file "arrays" and the key or channel at fault.

        Examples
        --------
        >>> import numpy as np
        >>> import rotorid_torch as rotorid
        >>> time = np.arange(0.0, 10.0, 0.02)
        >>> flight = {"time": time, "lat": 0.02 * np.sin(time), "p": 0.1 * np.cos(time)}
        >>> rotorid.Dataset.from_arrays({"f1": flight}, identify=["f1"])
        Dataset arrays, helicopter: controls lat; 1 identify, 0 validate, 0 acid: f1
        """
        document = {"format": 1, "name": name, "kind": kind, "description": description, "vehicle": vehicle}
        document |= {"controls": controls, "channels": channels}
        document |= {"flights": {"identify": identify, "validate": validate, "acid": acid}, "model": model}
        return cls(**vars(from_document(flights, document)))

    def __repr__(self) -> str:
        lists = ", ".join(f"{len(getattr(self, which))} {which}" for which in ("identify", "validate", "acid"))
        names = ", ".join(self.flights) if len(self.flights) <= SHOWN else f"{len(self.flights)} flights"
        return f"Dataset {self.name}, {self.kind}: controls {', '.join(self.controls)}; {lists}: {names}"

    def __getitem__(self, flight: str) -> Flight:
        """A flight by its name.

        Raises
        ------
        KeyError : there is none; with those there are.
        """
        if not isinstance(flight, str) or flight not in self.flights:
            raise KeyError(f"{self.name} has no flight '{flight}', but {', '.join(self.flights)}")
        return self.flights[flight]

    def with_flights(self, flights: Mapping[str, Flight]) -> Dataset:
        """The same with other records of its flights."""
        facts = {name: Facts.of(flight) for name, flight in flights.items()}
        return replace(self, flights=MappingProxyType(flights), facts=MappingProxyType(facts))

    def changed(self, change: Callable[[Flight], Flight]) -> Dataset:
        """The same with every flight changed, when it is asked for: in memory are those used last."""
        return self.with_flights(OnDemand(self.flights, lambda name: change(self.flights[name])))

    def recorded(self) -> Dataset:
        """The same without channels that were made from others."""
        if not self.derived:
            return self
        return replace(self, derived=frozenset(), dead_reckoned=False).changed(
            lambda flight: replace(flight, channels={c: v for c, v in flight.channels.items() if c not in self.derived})
        )

    def to_numpy(self) -> dict[str, dict[str, np.ndarray]]:
        """Channels (T,) of each flight by its name."""
        return {flight.name: flight.to_numpy() for flight in self}

    def to_pandas(self) -> Any:
        """All flights below each other as a DataFrame, with columns `flight` and `time`; InputError without pandas."""
        columns = list(dict.fromkeys(c for flight in self for c in flight.channels))
        parts = {c: np.concatenate([flight.stack([c])[:, 0].numpy() for flight in self]) for c in columns}
        return frame({"flight": np.concatenate([[f.name] * f.samples for f in self]), **parts})

    def plot(self, channels: Sequence[str] | None = None) -> dict[str, Figure]:
        """Each flight's channels over time as a matplotlib figure, by its name."""
        return {flight.name: flight.plot(channels) for flight in self}

    def windows(
        self,
        seconds: float = 2.0,
        every: float = 1.0,
        flights: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
    ) -> Windows:
        """Windows of flights as a torch Dataset, for a DataLoader.

        Parameters
        ----------
        seconds : length of a window. every : s from the start of one to that of the next.
        flights : by name; the identify list by default. outputs : channels; those that are scored by default.

        Raises
        ------
        InputError : a flight or channel that there is not, or no window fits.

        Examples
        --------
        >>> from torch.utils.data import DataLoader
        >>> import rotorid_torch as rotorid
        >>> data = rotorid.load("DATASET")
        >>> batch = next(iter(DataLoader(data.windows(seconds=2.0), batch_size=4)))
        >>> batch["controls"].shape
        torch.Size([4, 309, 4])
        """
        of, channels = "windows", sorted({c for facts in self.facts.values() for c in facts.channels})
        seconds = arguments.number(Argument(of, "seconds"), seconds, "s", above=0.0)
        every = arguments.number(Argument(of, "every"), every, "s", above=0.0)
        if flights is not None:
            flights = arguments.names(Argument(of, "flights"), flights, list(self.flights), "flight")
        if outputs is not None:
            outputs = arguments.names(Argument(of, "outputs"), outputs, channels, "channel")
        chosen = self.identify if flights is None else flights
        columns = self.scored() if outputs is None else outputs
        return windows_of([self.flights[name] for name in chosen], self.controls, columns, seconds, every)

    def _repr_html_(self) -> str:
        """A table of the flights, for a notebook."""
        rows = ((name, self.listed(name), facts.samples) for name, facts in self.facts.items())
        return html_table(repr(self), ("flight", "list", "samples"), rows)

    def __len__(self) -> int:
        return len(self.flights)

    def __iter__(self) -> Iterator[Flight]:
        return (self.flights[name] for name in self.flights)

    def __contains__(self, flight: object) -> bool:
        return flight in self.flights

    def noise(self, channel: str) -> float:
        """Standard deviation of a sample of a channel or control: declared, else from the identify flights.

        The estimate is the white floor of the spectrum (`white_noise`), at least a thousandth of the channel's rms
        deviation; a declared zero is raised to a thousandth of that again, so that no channel has infinite weight.
        """
        spec = self.control_specs.get(channel) or self.channel_specs.get(channel)
        if spec is None or spec.noise is None:
            return self._estimated_noise(channel)
        return spec.noise if spec.noise > 0 else max(1e-3 * NOISE_FLOOR * self.scales().get(channel, 0.0), 1e-12)

    def bias(self, channel: str) -> names.Bias:
        """Whether the sensor has a constant error per flight ("free") or not ("none"): declared, else by the table."""
        spec = self.channel_specs.get(channel)
        return spec.bias if spec is not None and spec.bias is not None else names.default_bias(channel)

    def quiet(self, flight: str) -> int:
        """Samples of a flight before any control moves beyond its noise; at least 0.5 s."""
        return self._quiet_parts[0][flight]

    @once
    def reference(self) -> Mapping[str, float]:
        """Trim: mean of every channel and control over the quiet parts of the identify flights, sample by sample."""
        quiet = self._quiet_parts[1]
        return MappingProxyType({c: total / n if n else self._mean(c) for c, (total, n) in quiet.items()})

    @once
    def scales(self) -> Mapping[str, float]:
        """Scale per channel and control: rms over all identify flights of (channel - its mean over the first 0.5 s)."""
        return MappingProxyType({channel: self._scale(channel) for channel in self._measured()})

    def scored(self) -> tuple[str, ...]:
        """Channels that a free run is scored on: those of `u v w p q r phi theta` measured in the identify flights."""
        return tuple(c for c in names.BODY if self.scales().get(c, 0.0) > 0.0 and c not in self.derived)

    def listed(self, flight: str) -> Literal["identify", "validate", "acid"]:
        """List that a flight is in: "identify", "validate" or "acid"."""
        return "identify" if flight in self.identify else "validate" if flight in self.validate else "acid"

    def file(self, flight: str) -> Path | str:
        """File of a flight, for messages; words where the data set was made from arrays."""
        return find_flight(self.path, flight) if self.path is not None else f"arrays: flight {flight}"

    def files(self) -> tuple[Path, ...]:
        """Files of the data set's folder, its truth among them; none where the data set was made from arrays."""
        if self.path is None:
            return ()
        listed = (file for part in FOLDERS for file in sorted((self.path / part).glob("*")))
        return (self.path / "dataset.toml", *listed)

    def some(self, most: int) -> tuple[str, ...]:
        """Identify flights, at most so many: one of each of as many parts of the list, always the same ones.

        Which one of a part is left to chance, for lists that take axis after axis in turn.
        """
        return _some(self.identify, most)

    @property
    def unseen(self) -> tuple[str, ...]:
        """Flights that no fit has seen and that decide: the validate list, or, where it is empty, the identify list."""
        return self.validate or self.identify

    def lacking_rates(self) -> Iterator[tuple[str, str, str]]:
        """Flights that lack one of the body rates, which every step needs; the rate, and how it is lacking."""
        still = {(flight, one.channel) for one in self.dead for flight in one.flights}
        for flight, facts in self.facts.items():
            for rate in names.RATES:
                if not facts.has(rate):
                    dead = (flight, rate) in still
                    yield flight, rate, "never changes: dead, or not connected" if dead else facts.lack(rate)

    def require_rates(self) -> None:
        """Raise InputError where a flight lacks one of the body rates, which every step needs."""
        for flight, rate, what in self.lacking_rates():
            raise InputError(self.file(flight), rate, what, "body rates p q r in rad/s that move, in every flight")

    @cached_property
    def _quiet_parts(self) -> tuple[dict[str, int], dict[str, tuple[float, int]]]:
        """Quiet samples of every flight; sum and number of each channel's samples in those of the identify flights."""
        spread = {control: self.scales()[control] for control in self.controls}
        noise = {control: self.noise(control) for control in self.controls}
        identify, samples = set(self.identify), dict[str, int]()
        sums: dict[str, tuple[float, int]] = dict.fromkeys(self._measured(), (0.0, 0))
        for name, flight in self.flights.items():
            samples[name] = quiet_samples(flight, noise, spread)
            for channel in sums if name in identify else ():
                if channel in flight.channels:
                    values = flight.channels[channel][: samples[name]]
                    total, count = sums[channel]
                    sums[channel] = total + float(values.nansum()), count + int((~values.isnan()).sum())
        return samples, sums

    def _mean(self, channel: str) -> float:
        """Mean over the whole identify flights, for a channel that is missing in all their quiet parts."""
        spreads = [facts.spreads[channel] for facts in self._identified() if facts.has(channel)]
        return sum(s.mean() * s.count for s in spreads) / sum(s.count for s in spreads)

    def _scale(self, channel: str) -> float:
        spreads = [facts.spreads[channel] for facts in self._identified() if facts.has(channel)]
        return math.sqrt(sum(s.squares for s in spreads) / sum(s.count for s in spreads))

    def _identified(self) -> Iterator[Facts]:
        """Facts of the identify flights."""
        return (self.facts[name] for name in self.identify)

    def _measured(self) -> tuple[str, ...]:
        """Channels besides time that any identify flight has, in order of appearance."""
        measured = {channel: None for facts in self._identified() for channel in facts.spreads}
        return tuple(channel for channel in measured if channel != "time")

    @cached_property
    def _estimates(self) -> dict[str, float]:
        return {}

    def _estimated_noise(self, channel: str) -> float:
        if channel not in self._estimates:
            estimate, least = white_noise(self.records(channel)), NOISE_FLOOR * self.scales().get(channel, 0.0)
            self._estimates[channel] = max(estimate if math.isfinite(estimate) else 0.0, least, 1e-12)
        return self._estimates[channel]

    def records(self, channel: str) -> list[np.ndarray]:
        """A channel's records (T,) in the identify flights that have it, a hundred at most: enough for a spectrum."""
        flights = [name for name in self.identify if self.facts[name].has(channel)]
        return [self.flights[name].channels[channel].numpy() for name in _some(flights, ENOUGH)]


def _some(flights: Sequence[str], most: int) -> tuple[str, ...]:
    """At most so many, spread over the list."""
    if len(flights) <= most:
        return tuple(flights)
    places = (np.arange(most) + np.random.default_rng(0).random(most)) * len(flights) / most
    return tuple(flights[int(place)] for place in places)


def load(path: str | Path) -> Dataset:
    """Read and validate the data set in a folder: dataset.toml and flights/NAME.npz or .csv. `truth/` is never read.

    Raises
    ------
    InputError : with the file, the channel or key, what is wrong and what was expected.

    Examples
    --------
    >>> import rotorid_torch as rotorid
    >>> data = rotorid.load("DATASET")
    >>> data["f321_lon"].has("p", "q", "r")
    True
    """
    return Dataset(**vars(from_folder(path)))
