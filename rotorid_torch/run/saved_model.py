"""Free run of a saved model on a flight of a data set."""

from __future__ import annotations

import math
import warnings as python_warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rotorid_torch.core.storage.atomic import restore
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.velocities import with_velocities
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.errors import InputError
from rotorid_torch.model.save import load as load_model
from rotorid_torch.run.output.folder import free_run_file, refuse_unless_free_run
from rotorid_torch.validate.free_run import free_run, windows

if TYPE_CHECKING:
    pass


OUTSIDE = 0.1
"""Share of the identified range by which a free run may leave it before it is told."""


def simulate(
    model: str | Path,
    dataset: Dataset,
    flight: str,
    out: str | Path,
    start: float = 0.0,
    seconds: float | None = None,
    *,
    overwrite: bool = False,
) -> dict[str, np.ndarray]:
    """Free run of a saved model on a flight, written as NAME.npz: time, outputs, states; warns outside the range.

    Parameters
    ----------
    model : a RUN or a model.pt. start : s, where the run begins. seconds : its length; to the flight's end by default.
    overwrite : replace a file at `out` that is no earlier free run; files of the model and the data set never.

    Raises
    ------
    InputError : no such model or flight, a control is missing, start and seconds leave the flight, or `out` is in the
        way.
    """
    place = Path(model)
    restore(place)
    file = place / "model.pt" if place.is_dir() else place
    how = {"overwrite": overwrite, "inputs": (file, *dataset.files())}
    refuse_unless_free_run(out, **how)
    loaded, spec = load_model(file)
    if flight not in dataset.flights:
        raise InputError(
            dataset.path or dataset.name, "flight", f"there is no flight '{flight}'", ", ".join(dataset.flights)
        )
    dataset = with_velocities(dataset)
    record = dataset.flights[flight]
    first, samples = _span(record.dt, record.samples, start, seconds, dataset.file(flight))
    missing = [c for c in loaded.body.controls if not record.has(c)]
    if missing:
        raise InputError(dataset.file(flight), missing[0], "control is missing", "the controls of the model")
    pieces = windows(loaded, dataset, [(flight, first)], samples)
    states, outputs = free_run(loaded, pieces)
    arrays = {"time": record.time[first : first + samples].numpy()}
    arrays |= dict(zip(loaded.layout.names, states[0].numpy().T, strict=True))
    arrays |= dict(zip(loaded.body.outputs, outputs[0].numpy().T, strict=True))
    _warn_outside(arrays | dict(zip(loaded.body.controls, pieces.controls[0].numpy().T, strict=True)), spec)
    with free_run_file(out, **how) as partial, partial.open("wb") as handle:
        np.savez(handle, **arrays)  # pyright: ignore[reportArgumentType]
    return arrays


def _span(dt: float, samples: int, start: float, seconds: float | None, file: str | Path) -> tuple[int, int]:
    last = (samples - 2) * dt
    if not -0.5 * dt <= start < last + 0.5 * dt:
        raise InputError(file, "start", f"{start} s lies outside the flight", f"0 to {last:.2f} s")
    first = round(start / dt)
    if seconds is None:
        return first, samples - first
    if not 0.5 * dt < seconds < math.inf:
        raise InputError(file, "seconds", f"is {seconds}", f"at least one sample interval, {dt:.4g} s")
    wanted = round(seconds / dt) + 1
    return first, min(wanted, samples - first)


def _warn_outside(arrays: dict[str, np.ndarray], spec: ModelSpec) -> None:
    left = []
    for name, (low, high) in spec.ranges.items():
        margin = OUTSIDE * (high - low)
        if name in arrays and (np.nanmin(arrays[name]) < low - margin or np.nanmax(arrays[name]) > high + margin):
            left.append(name)
    if left:
        said = f"the run leaves the range of the flights that the model was identified from in {', '.join(left)}"
        python_warnings.warn(f"{said}; do not trust it there", stacklevel=3)
