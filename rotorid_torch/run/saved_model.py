"""A run opened by its folder, and the free run of a model on a flight."""

import math
import os
import warnings as python_warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.core.storage.atomic import restore
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.on_demand import OnDemand
from rotorid_torch.data.velocities.source import with_velocities
from rotorid_torch.errors import InputError, OutsideRange, nearest
from rotorid_torch.exporting.fmu_run import Span, fly_fmu, read_facts
from rotorid_torch.model.model import Model
from rotorid_torch.model.save import load as load_model
from rotorid_torch.run.output.arguments import of_data
from rotorid_torch.run.output.folder import free_run_file, is_table, refuse_unless_free_run
from rotorid_torch.run.result import Result
from rotorid_torch.validate.free_run import free_run, windows

OUTSIDE = 0.1
"""Share of the identified range by which a free run may leave it before it is told."""


def open_run(path: str | Path) -> Result:
    """A run that `identify` or `close_loop` wrote, from its folder.

    Raises
    ------
    InputError : there is no run, or its report cannot be read; where the model is asked for, that has none.

    Examples
    --------
    >>> import rotorid_torch as rotorid
    >>> run = rotorid.open_run("RUN")
    >>> run["M.q"].unit
    '1/s'
    """
    return Result.load(path)


def export(run: Result | str | Path, **options: Any) -> dict[str, Path]:
    """Write the model of a run for other tools; what was written, by target.

    Parameters
    ----------
    run : of `identify` or `close_loop`, or the path of a RUN. options : as `run.export`: fmu, statespace, onnx, csv a
        file, c a folder; fmi the version of the FMU, overwrite; model one that was trained in torch.

    Raises
    ------
    InputError : no such run, a place is taken, a compiler or package is missing, or the model has no such form.
    """
    if isinstance(run, Model):
        raise Argument("export", "run").wrong("is a Model", "its Run, and model=MODEL beside it")
    return (run if isinstance(run, Result) else open_run(run)).export(**options)


def simulate(
    model: Model | Result | str | Path,
    flight: Flight,
    start: float = 0.0,
    seconds: float | None = 8.0,
    data: Dataset | None = None,
) -> dict[str, np.ndarray]:
    """Free run of a model on a flight: controls measured, initial state from the first second.

    Parameters
    ----------
    model : a model, a run, or the path of a RUN, a model.pt or an FMU that `export` wrote.
    start, seconds : where the free run begins, and its length, s; it ends with the flight at the latest, or by None.
    data : the data set of the flight, with the noise of its channels; without it the flight alone tells the noise.

    Returns
    -------
    By name "time" (T,) s, and each state and output (T,) in SI units. Warns where the run leaves the range of the
    flights that the model was identified from.

    Raises
    ------
    InputError : there is no such model, a control is missing, start lies outside the flight, or seconds is not above 0.

    Examples
    --------
    >>> import rotorid_torch as rotorid
    >>> data = rotorid.load("DATASET")
    >>> free = rotorid.simulate("RUN", data["f321_lat"], seconds=2.0, data=data)
    >>> float(free["time"][-1])
    2.0
    """
    of = "simulate"
    arguments.instance(Argument(of, "flight"), flight, Flight, 'a Flight: data["NAME"]')
    arguments.optional(of_data)(Argument(of, "data"), data)
    start = arguments.number(Argument(of, "start"), start, "s")
    seconds = None if seconds is None else arguments.number(Argument(of, "seconds"), seconds, "s", above=0.0)
    source = _source(model)
    if data is None or data.flights.get(flight.name) is not flight:  # one that was changed flies as it is
        controls: Mapping[str, Any] = {c: {} for c in source.controls} if data is None else data.control_specs
        alone = Dataset.from_arrays({flight.name: flight.channels}, identify=[flight.name], controls=controls)
        data = alone if data is None else _exchanged(data, alone[flight.name])
    return _free_run(source, data, flight.name, Stretch(start, seconds))


def _exchanged(data: Dataset, flight: Flight) -> Dataset:
    """The data set with this flight in place of the one of its name."""
    return replace(data, flights=OnDemand(data.flights, lambda name: flight if name == flight.name else data[name]))


@dataclass(frozen=True)
class Stretch:
    """Where a free run begins, s, and how long it is, s; to the flight's end by default."""

    start: float = 0.0
    seconds: float | None = None


@dataclass(frozen=True)
class _Source:
    """What flies: its controls, the ranges that it was identified in, and the free run of a piece of a flight."""

    controls: tuple[str, ...]
    ranges: Mapping[str, tuple[float, float]]
    fly: Callable[[Dataset, str, Span], dict[str, np.ndarray]]


def _source(model: Model | Result | str | Path) -> _Source:
    if isinstance(model, Model):
        return _of_model(model, {})
    if isinstance(model, Result):
        return _of_model(model.model, model.spec.ranges)
    if not isinstance(model, str | os.PathLike):
        wrong = f"is {arguments.described(model)}"
        raise Argument("simulate", "model").wrong(wrong, "a Model, a Run, or the path of a RUN, a model.pt or an FMU")
    place = arguments.place(Argument("simulate", "model"), model)
    restore(place)
    if place.suffix == ".fmu":
        facts = read_facts(place)
        return _Source(facts.controls, facts.ranges, partial(fly_fmu, place, facts))
    loaded, spec = load_model(_file(place))
    return _of_model(loaded, spec.ranges)


def _file(place: Path) -> Path:
    return place / "model.pt" if place.is_dir() else place


def _of_model(model: Model, ranges: Mapping[str, tuple[float, float]]) -> _Source:
    if model.theta.dtype != torch.float64:
        raise Argument("simulate", "model").wrong(f"holds numbers of {model.theta.dtype}", "float64: model.double()")
    return _Source(model.body.controls, ranges, partial(_fly, model))


def _fly(model: Model, dataset: Dataset, flight: str, span: Span) -> dict[str, np.ndarray]:
    pieces = windows(model, dataset, [(flight, span.first)], span.samples)
    states, outputs = free_run(model, pieces)
    arrays = {"time": dataset.flights[flight].time[span.first : span.first + span.samples].numpy()}
    arrays |= dict(zip(model.layout.names, states[0].numpy().T, strict=True))
    return arrays | dict(zip(model.body.outputs, outputs[0].numpy().T, strict=True))


def write_free_run(
    model: str | Path,
    dataset: Dataset,
    flight: str,
    out: str | Path,
    piece: Stretch = Stretch(),
    *,
    overwrite: bool = False,
) -> dict[str, np.ndarray]:
    """Free run of a saved model on a flight, as NAME.npz or NAME.csv: time, outputs, states; warns outside the range.

    model : a RUN, a model.pt or an FMU.
    overwrite : replace a file at `out` that is no earlier free run; files of the model and the data set never.

    Raises InputError: no such model or flight, a control is missing, start lies outside the flight, seconds is not
    above 0, or `out` is in the way.
    """
    how = {"overwrite": overwrite, "inputs": (_file(Path(model)), *dataset.files())}
    refuse_unless_free_run(out, **how)
    arrays = _free_run(_source(model), dataset, flight, piece)
    with free_run_file(out, **how) as partial, partial.open("wb") as handle:
        if is_table(out):
            np.savetxt(
                handle, np.column_stack(list(arrays.values())), "%.10g", ",", header=",".join(arrays), comments=""
            )
        else:
            np.savez(handle, **arrays)  # pyright: ignore[reportArgumentType]
    return arrays


def _free_run(source: _Source, dataset: Dataset, flight: str, piece: Stretch) -> dict[str, np.ndarray]:
    if flight not in dataset.flights:
        wrong = f"there is no flight '{flight}'{nearest(flight, dataset.flights)}"
        raise InputError(dataset.path or dataset.name, "flight", wrong, ", ".join(dataset.flights))
    dataset = with_velocities(dataset)
    record, file = dataset.flights[flight], dataset.file(flight)
    span = _span(record.dt, record.samples, piece, file)
    during = slice(span.first, span.first + span.samples)
    until = record.stack(source.controls)[: during.stop]  # a later value is none of the run's
    for control, values in zip(source.controls, until.T, strict=True):
        if bool(values.isnan().all()):
            raise InputError(file, control, "control is missing", "the model's controls, measured by the run's end")
    arrays = source.fly(dataset, flight, span)
    inputs = record.bridged(source.controls)[during]
    _warn_outside(arrays | dict(zip(source.controls, inputs.numpy().T, strict=True)), source.ranges)
    return arrays


def _span(dt: float, samples: int, piece: Stretch, file: str | Path) -> Span:
    start, seconds = piece.start, piece.seconds
    last = (samples - 2) * dt
    if not -0.5 * dt <= start < last + 0.5 * dt:
        raise InputError(file, "start", f"{start} s lies outside the flight", f"0 to {last:.2f} s")
    first = round(start / dt)
    if seconds is None:
        return Span(first, samples - first)
    if not 0.5 * dt < seconds < math.inf:
        raise InputError(file, "seconds", f"is {seconds}", f"at least one sample interval, {dt:.4g} s")
    wanted = round(seconds / dt) + 1
    return Span(first, min(wanted, samples - first))


def _warn_outside(arrays: dict[str, np.ndarray], ranges: Mapping[str, tuple[float, float]]) -> None:
    left = []
    for name, (low, high) in ranges.items():
        margin = OUTSIDE * (high - low)
        if name in arrays and (np.nanmin(arrays[name]) < low - margin or np.nanmax(arrays[name]) > high + margin):
            left.append(name)
    if left:
        said = f"the run leaves the range of the flights that the model was identified from in {', '.join(left)}"
        python_warnings.warn(f"{said}; do not trust it there", OutsideRange, stacklevel=4)
