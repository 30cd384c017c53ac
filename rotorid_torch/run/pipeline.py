"""The order of the steps: the only file that knows it."""

from __future__ import annotations

import math
import warnings as python_warnings
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import torch
from torch import Tensor

from rotorid_torch.consistency.examination.needs import refuse_lacks
from rotorid_torch.core.atomic import restore
from rotorid_torch.core.ranks import ALONE, Ranks
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.one_rate import at_one_rate
from rotorid_torch.data.velocities import with_velocities
from rotorid_torch.effects.registry import of_others, registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.errors import InputError
from rotorid_torch.identification import reconstruct as step1
from rotorid_torch.identification.reconstruct import Reconstruction
from rotorid_torch.identification.rotor_regression import regress_rotors
from rotorid_torch.identification.step2 import Step2, regress_model
from rotorid_torch.identification.step3 import Step3, estimate_model
from rotorid_torch.identification.structure import propose, rival
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.model.save import load as load_model
from rotorid_torch.model.save import save as save_model
from rotorid_torch.run import limits, remarks
from rotorid_torch.run.checkpoint import Checkpoint, Steps, checkpoint
from rotorid_torch.run.figures import draw
from rotorid_torch.run.fit_record import fit_record, judge
from rotorid_torch.run.folder import free_run_file, refuse_unless_free_run, run_folder
from rotorid_torch.run.monitor import Monitor, peak_memory_mb
from rotorid_torch.run.own_effects import refuse_faulty
from rotorid_torch.run.records import DatasetRecord, FitRecord, ParameterRecord, Report, package_version
from rotorid_torch.run.write import write_report
from rotorid_torch.validate.free_run import free_run, windows
from rotorid_torch.validate.predictions import unexplained_moments

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rotorid_torch.run.figures import Overlay

OUTSIDE = 0.1
"""Share of the identified range by which a free run may leave it before it is told."""


@dataclass(frozen=True, eq=False)
class Run:
    """An identified model with everything that is known about it.

    model : the fitted module. fit : parameters, modes and scores. warnings : sentences for people.
    """

    model: Model
    spec: ModelSpec
    fit: FitRecord
    record: Report
    reconstruction: Reconstruction
    regressions: Step2
    estimate: Step3
    overlays: tuple[Overlay, ...] = field(repr=False)

    @property
    def scores(self) -> dict[str, float | None]:
        """J over the lists of flights: identify, validate, acid."""
        totals = self.fit.scores
        return {"identify": totals.identify, "validate": totals.validate, "acid": totals.acid}

    @property
    def parameters(self) -> tuple[ParameterRecord, ...]:
        """Every parameter with its standard error, unit, bounds and status."""
        return self.fit.parameters

    def table(self) -> str:
        """The parameters as text, one a line."""
        errors = torch.tensor([p.se if p.se is not None else torch.nan for p in self.fit.parameters])
        return self.model.parameter_set.table(self.model.theta, errors)

    def plot(self) -> dict[str, Figure]:
        """The report's pictures as matplotlib figures, by name."""
        return draw(self.overlays, self.fit)

    def report(self, path: str | Path) -> Path:
        """Write the RUN (report, pictures, model, reconstruction) to a folder; InputError where it is not free."""
        with run_folder(path, self.record.command) as folder:
            self.write(folder)
        return Path(path)

    def write(self, folder: Path, monitor: Monitor | None = None) -> None:
        """Write everything but log and TensorBoard records into an open run folder."""
        write_model(self, folder)
        write_report(folder, self.record, self.overlays, monitor)


def reconstruct(dataset: Dataset, out: str | Path, *, seed: int = 0, monitor: Monitor | None = None) -> Reconstruction:
    """Step 1 alone, written as a RUN."""
    dataset, monitor = with_velocities(dataset), monitor or Monitor()
    with run_folder(out, "reconstruct") as folder, monitor.recording(folder):
        with monitor.step("reconstruct"):
            found = step1.reconstruct(dataset)
        _write_reconstruction(found, folder)
        told = [*remarks.of_reading(dataset), *found.notes]
        write_report(folder, _report("reconstruct", dataset, seed, monitor, None, told), (), monitor)
    return found


def identify(
    dataset: Dataset,
    *,
    effects: Sequence[str] = (),
    out: str | Path | None = None,
    seed: int = 0,
    device: str = "cpu",
    monitor: Monitor | None = None,
    resume: bool = False,
    ranks: Ranks = ALONE,
) -> Run:
    """The three steps, free runs and scores; written as a RUN where `out` says so.

    Parameters
    ----------
    effects : ids of effects that join the model, such as "control.delay"; the report says whether each earned its
        place.
    out : folder of the run; an earlier RUN there is replaced when the new one is whole.
    device : "cpu" or "cuda", where filter, smoother and step 3 run; in float64 on both.
    resume : go on from the last finished step of an interrupted run to `out`, if there is one.
    ranks : processes that share the work, each of which calls this; the first one alone writes.

    Raises
    ------
    InputError : the data set lacks what the steps need, an effect does not exist, `out` is not free, the interrupted
        run was another one, or there are more ranks than identify flights.
    LostRank : another rank has ended; an earlier RUN stays as it was.
    """
    monitor = monitor or Monitor()
    refuse(dataset, effects, device)
    ranks.refuse_more_than(len(dataset.identify))
    torch.manual_seed(seed)
    with ExitStack() as stack:
        folder, kept = None, Checkpoint()
        if out is not None and ranks.first:
            key = _key(dataset, effects, seed)
            kept = stack.enter_context(checkpoint(out, key, resume=resume, keep=resume or ranks.size > 1))
            folder = stack.enter_context(run_folder(out, "identify"))
            stack.enter_context(monitor.recording(folder))
        run = identified(dataset, effects, seed, Steps(monitor, ranks, kept, device))
        if folder is not None:
            run.write(folder, monitor)
    return run


def _key(dataset: Dataset, effects: Sequence[str], seed: int) -> dict[str, str]:
    """What the steps' results depend on."""
    chosen = ", ".join(effects) or "none"
    return {"version": package_version(), "data set": dataset.sha256, "effects": chosen, "seed": str(seed)}


def identified(dataset: Dataset, effects: Sequence[str], seed: int, steps: Steps) -> Run:
    """The three steps, free runs and scores."""
    dataset = with_velocities(dataset)
    seen, monitor = at_one_rate(dataset), steps.monitor
    reconstruction = steps.reconstruct(
        tuple(seen.flights), lambda: step1.reconstruct(seen, None, steps.ranks, steps.device)
    )
    first = steps.do("structure", "structure", lambda: propose(seen, reconstruction, effects))
    tried = [estimated(spec, seen, reconstruction, steps) for spec in (first, rival(first)) if spec is not None]
    spec, model, regressions, estimate = min(tried, key=lambda t: t[3].criterion)
    with monitor.step("validate"):
        judged = judge(model, dataset, steps.ranks)
    fit = fit_record(model, spec, estimate, judged)
    told = remarks_on(seen, spec, fit, reconstruction, regressions, estimate)
    report = _report("identify", seen, seed, monitor, fit, told)
    run = Run(model, spec, fit, report, reconstruction, regressions, estimate, judged.overlays)
    if not effects:
        return run
    from rotorid_torch.run.earned import with_evidence  # which is about runs

    with monitor.step("trace"):
        run = with_evidence(run, seen, effects, seed)
    return replace(run, record=msgspec.structs.replace(run.record, time_s=monitor.time_record()))


def remarks_on(
    seen: Dataset, spec: ModelSpec, fit: FitRecord, reconstruction: Reconstruction, regressions: Step2, estimate: Step3
) -> list[str]:
    """What people should know of the flights that the steps saw, of the steps, and of the fit they came to."""
    return [
        *remarks.of_check(seen),
        *remarks.of_reading(seen),
        *reconstruction.notes,
        *remarks.of_clocks(seen),
        *remarks.of_controls(seen, regressions.own_share),
        *remarks.of_regressions(regressions),
        *remarks.of_estimate(estimate, fit),
        *limits.of_channels(seen, spec),
        *limits.of_rotors(spec, fit),
        *limits.of_flapping(fit),
    ]


def estimated(
    spec: ModelSpec, dataset: Dataset, reconstruction: Reconstruction, steps: Steps
) -> tuple[ModelSpec, Model, Step2, Step3]:
    """Steps 2 and 3 of one structure."""
    model, monitor = build(spec), steps.monitor
    regress = regress_rotors if spec.motors else regress_model
    regressions = steps.do("ftr", f"ftr-{spec.flapping}", lambda: regress(model, dataset, reconstruction))
    if spec.motors:
        spec, model, regressions = _told(spec, model, regressions, dataset)
    monitor.scalars({f"ftr/R2/{row}": float(r.r2) for row, r in regressions.regressions.items()}, 0)
    for line in remarks.regression_table(regressions):
        monitor.log(line)

    def watch(iteration: int, cost: float, theta: Tensor) -> None:
        monitor.scalars({"ml/cost": cost}, iteration)

    def third() -> Step3:
        return estimate_model(model, dataset, reconstruction, regressions, watch, steps.ranks, steps.device)

    estimate = steps.do("ml", f"ml-{spec.flapping}", third)
    with torch.no_grad():
        model.theta.copy_(estimate.theta_of(model, regressions))
    monitor.say(f"flapping {spec.flapping}: Akaike's criterion {estimate.criterion:.6g}")
    return spec, model, regressions, estimate


def _told(spec: ModelSpec, model: Model, regressions: Step2, dataset: Dataset) -> tuple[ModelSpec, Model, Step2]:
    """A multirotor's structure with those control powers held at zero whose rates are better held than predicted."""
    with torch.no_grad():
        model.theta.copy_(regressions.theta)
    rows = unexplained_moments(model, (dataset.flights[name] for name in dataset.identify))
    held = [name for row in rows for name in (f"rotors.power.{row}", f"rotors.trim.{row}")]
    theta = regressions.theta.clone()
    theta[[model.parameter_set.index(name) for name in held]] = 0.0
    spec = msgspec.structs.replace(
        spec, free={**spec.free, **dict.fromkeys(held, False)}, values={**spec.values, **dict.fromkeys(held, 0.0)}
    )
    return spec, build(spec), replace(regressions, theta=theta)


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
    found = {"time": record.time[first : first + samples].numpy()}
    found |= dict(zip(loaded.layout.names, states[0].numpy().T, strict=True))
    found |= dict(zip(loaded.body.outputs, outputs[0].numpy().T, strict=True))
    _warn_outside(found | dict(zip(loaded.body.controls, pieces.controls[0].numpy().T, strict=True)), spec)
    with free_run_file(out, **how) as partial, partial.open("wb") as handle:
        np.savez(handle, **found)  # pyright: ignore[reportArgumentType]
    return found


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


def _warn_outside(found: dict[str, np.ndarray], spec: ModelSpec) -> None:
    left = []
    for name, (low, high) in spec.ranges.items():
        margin = OUTSIDE * (high - low)
        if name in found and (np.nanmin(found[name]) < low - margin or np.nanmax(found[name]) > high + margin):
            left.append(name)
    if left:
        said = f"the run leaves the range of the flights that the model was identified from in {', '.join(left)}"
        python_warnings.warn(f"{said}; do not trust it there", stacklevel=3)


def refuse(dataset: Dataset, effects: Sequence[str], device: str) -> None:
    """Refuse what identify cannot do: effects that are not there, a device, data that no step can make a model of."""
    for name in effects:
        if name not in registered():
            raise InputError("--effect", name, "there is no such effect", f"one of {', '.join(sorted(registered()))}")
        if list(effects).count(name) > 1:
            raise InputError("--effect", name, "is named twice", "each effect once")
    if device not in ("cpu", "cuda"):
        raise InputError("--device", device, "there is no such device", "cpu or cuda")
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device", device, "no CUDA device is available here", "cpu")
    refuse_lacks(dataset)
    others = of_others()
    own = [name for name in effects if name in others]
    if own:
        refuse_faulty(own, propose(with_velocities(dataset), None))


def _report(
    command: str, dataset: Dataset, seed: int, monitor: Monitor, fit: FitRecord | None, told: Sequence[str]
) -> Report:
    return Report(
        command=command,
        dataset=DatasetRecord(name=dataset.name, sha256=dataset.sha256),
        seed=seed,
        time_s=monitor.time_record(),
        peak_memory_mb=peak_memory_mb(),
        before=fit,
        warnings=tuple(told),
    )


def write_model(run: Run, folder: Path) -> None:
    """Reconstruction and model.pt of a run."""
    _write_reconstruction(run.reconstruction, folder)
    save_model(run.model, run.spec, folder / "model.pt")


def _write_reconstruction(found: Reconstruction, folder: Path) -> None:
    (folder / "reconstruct").mkdir(exist_ok=True)
    for name in found.flights:
        np.savez(folder / "reconstruct" / f"{name}.npz", **found.arrays(name))  # pyright: ignore[reportArgumentType]
