"""Flights cut into windows of one length, as a torch Dataset: for a DataLoader and mini-batches."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.utils.data import Dataset

from rotorid_torch.arguments import listed
from rotorid_torch.data.flight import Flight
from rotorid_torch.errors import InputError


@dataclass(frozen=True, eq=False, repr=False)
class Windows(Dataset[dict[str, Tensor]]):
    """Windows of flights, each a dict: time (T,) s from its start, controls (T, nu), outputs (T, n), flight, start.

    Attributes
    ----------
    controls, outputs : names of the columns. flights : names, by the number that a window's `flight` is.
    dt : sample interval, s. places : flight and first sample of each window.
    """

    controls: tuple[str, ...]
    outputs: tuple[str, ...]
    flights: tuple[str, ...]
    dt: float
    samples: int
    records: tuple[tuple[Tensor, Tensor], ...]
    places: tuple[tuple[int, int], ...]

    def __repr__(self) -> str:
        names = f"controls {listed(self.controls)}; outputs {listed(self.outputs)}"
        return f"Windows: {len(self)} of {self.samples} samples every {self.dt:.4g} s; {names}"

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, index: int) -> dict[str, Tensor]:
        flight, first = self.places[index]
        part = slice(first, first + self.samples)
        controls, outputs = self.records[flight]
        return {
            "time": self.dt * torch.arange(self.samples, dtype=torch.float64),
            "controls": controls[part],
            "outputs": outputs[part],
            "flight": torch.tensor(flight),
            "start": torch.tensor(first * self.dt, dtype=torch.float64),
        }


def windows_of(
    flights: Iterable[Flight], controls: Sequence[str], outputs: Sequence[str], seconds: float, every: float
) -> Windows:
    """Windows of `seconds`, one beginning every `every` seconds; controls bridged, outputs NaN where missing.

    Raises InputError: no flight, flights of several sample intervals, or none as long as a window.
    """
    flights = list(flights)
    if not flights:
        raise InputError("windows", "flights", "are none", "one or more")
    dt = flights[0].dt
    if other := next((f for f in flights if abs(f.dt - dt) > 1e-6 * dt), None):
        wrong = f"{other.name} has samples {other.dt:.4g} s apart, {flights[0].name} {dt:.4g} s"
        raise InputError("windows", "flights", wrong, "flights of one sample interval")
    samples, step = round(seconds / dt) + 1, max(1, round(every / dt))
    places = [(k, first) for k, f in enumerate(flights) for first in range(0, f.samples - samples + 1, step)]
    if samples < 2 or not places:
        longest = dt * (max(f.samples for f in flights) - 1)
        raise InputError("windows", "seconds", f"is {seconds:g}", f"{dt:.4g} s to {longest:.4g} s, the longest flight")
    records = tuple((f.bridged(controls), f.stack(outputs)) for f in flights)
    return Windows(tuple(controls), tuple(outputs), tuple(f.name for f in flights), dt, samples, records, tuple(places))
