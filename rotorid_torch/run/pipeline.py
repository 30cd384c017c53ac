"""The order of the steps: the only file that knows it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import msgspec
import torch
from torch import Tensor

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.consistency.examination.needs import refuse_lacks
from rotorid_torch.core.processes.forks import forked
from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.one_rate import at_one_rate
from rotorid_torch.data.velocities.source import with_velocities
from rotorid_torch.effects.registry import of_others, registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.errors import InputError, nearest
from rotorid_torch.identification.method_choice import METHODS
from rotorid_torch.identification.model_estimation import Means, ModelEstimate, estimate_model
from rotorid_torch.identification.model_regression import ModelRegression, regress_model
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct as motion_and_forces
from rotorid_torch.identification.structure import propose, rival
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.model.own_effects import refuse_faulty
from rotorid_torch.report import limits, remarks
from rotorid_torch.run.fit_record import fit_record, for_pictures, judge
from rotorid_torch.run.free_runs import unfed_score
from rotorid_torch.run.loop_record import with_evidence
from rotorid_torch.run.output.arguments import refuse_arguments
from rotorid_torch.run.output.checkpoint import Checkpoint, Steps, checkpoint
from rotorid_torch.run.output.curves import Curves
from rotorid_torch.run.output.folder import run_folder
from rotorid_torch.run.output.monitor import Monitor
from rotorid_torch.run.output.write import report_of, write_report
from rotorid_torch.run.result import Run, write_reconstruction
from rotorid_torch.run.turbulence import UNSEEN_BETTER, method_by_quiet_moments, smoothed_gusts
from rotorid_torch.validate.rotor_moments import regressed_rotors, silent_moments, within_belief
from rotorid_torch.version import __version__

UNUSED = "u v w are not measured: a model with those dead reckoned from specific forces flies these flights worse"
"""Remark on a data set whose velocities could be dead reckoned, and are not."""

AnyRun = TypeVar("AnyRun", bound=Run)


def reconstruct(dataset: Dataset, out: str | Path, *, seed: int = 0, monitor: Monitor | None = None) -> Reconstruction:
    """Step 1 alone, written as a RUN."""
    seed = arguments.seed(Argument("reconstruct", "seed"), seed)
    refuse_arguments("reconstruct", dataset=dataset, out=out, monitor=monitor)
    dataset, monitor = with_velocities(dataset), monitor or Monitor()
    with run_folder(out, "reconstruct") as folder, monitor.recording(folder):
        with monitor.step("reconstruct"):
            reconstruction = motion_and_forces(dataset)
        write_reconstruction(reconstruction, folder)
        notes = [*remarks.of_reading(dataset), *reconstruction.notes]
        write_report(folder, report_of("reconstruct", dataset, seed, monitor, None, notes), None, monitor)
    return reconstruction


def identify(
    dataset: Dataset,
    *,
    effects: Sequence[str] = (),
    out: str | Path | None = None,
    seed: int = 0,
    device: str = "cpu",
    method: str = "auto",
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
    method : of step 3: "output-error", "filter-error", or "auto", the latter where the air moves.
    resume : go on from the last finished step of an interrupted run to `out`, if there is one.
    ranks : processes that share the work, each of which calls this; the first one alone writes.

    Raises
    ------
    InputError : the data set lacks what the steps need, an effect or method does not exist, `out` is not free, the
        interrupted run was another one, or there are more ranks than identify flights.
    LostRank : another rank has ended; an earlier RUN stays as it was.

    Source: the chapters of `identification` name theirs; Morelli and Klein, Aircraft System Identification (2nd ed.).

    Examples
    --------
    >>> import rotorid_torch as rotorid
    >>> data = rotorid.load("DATASET")
    >>> run = rotorid.identify(data)
    >>> run.scores["identify"] < 0.2
    True
    >>> run["M.q"].unit
    '1/s'
    """
    effects = list(effects) if isinstance(effects, Iterator) else effects
    seed = arguments.seed(Argument("identify", "seed"), seed)
    refuse_arguments("identify", dataset=dataset, effects=effects, out=out, device=device)
    refuse_arguments("identify", monitor=monitor, resume=resume, ranks=ranks)
    monitor = monitor or Monitor()
    refuse(dataset, effects, device, method)
    if resume and out is None:
        raise InputError("identify", "resume", "is True without `out`", "the folder of the interrupted run: out=...")
    ranks.refuse_more_than(len(dataset.identify))
    steps = Steps(monitor, ranks, Checkpoint(), device, method)
    whole = partial(identified, effects=effects, seed=seed)
    if out is None or not ranks.first:
        return on_velocities(dataset, steps, whole)[1]
    key = _key(dataset, effects, seed, method)
    finished = checkpoint(out, key, resume=resume, keep=resume or ranks.size > 1)
    with finished as results, run_folder(out, "identify") as folder, monitor.recording(folder):
        dataset, run = on_velocities(dataset, replace(steps, results=results), whole)
        pictured(run, dataset).write(folder, monitor)
    return run


def on_velocities(dataset: Dataset, steps: Steps, whole: Callable[..., Run]) -> tuple[Dataset, Run]:
    """A run of a data set with the velocities that can be made where none are measured, behind that data set.

    Dead reckoning is right in still air and from a steady start. So two models are fitted, with and without these
    velocities, and that of the better free runs over flights that no fit has seen is taken.

    whole : makes a run of a data set by `steps`.
    """
    moving = with_velocities(dataset)
    if moving.dead_reckoned and steps.method == "filter-error":  # a drift looks like gusts
        moving = dataset
    if not moving.dead_reckoned:
        return moving, whole(moving, steps=steps)
    plain = replace(dataset, warnings=(*dataset.warnings, UNUSED))
    candidates = [(moving, whole(moving, steps=steps))]
    with suppress(InputError):  # an effect that was asked for may need velocities
        candidates.append((plain, whole(plain, steps=replace(steps, model="rates-"))))
    return min(candidates, key=lambda candidate: unfed_score(candidate[1]))


def pictured(run: AnyRun, dataset: Dataset) -> AnyRun:
    """The run with what its pictures show besides: errors of the model, and what each named effect does."""
    sizes = run.model.parameter_set.sizes
    named = [e.id for e in run.record.effects if e.verdict in ("accepted", "indistinguishable") and sizes(e.id)]
    overlays = for_pictures(run.overlays, run.model, dataset, run.estimate, named)
    return replace(run, overlays=overlays)


def _key(dataset: Dataset, effects: Sequence[str], seed: int, method: str) -> dict[str, str]:
    """What the steps' results depend on."""
    chosen = ", ".join(effects) or "none"
    return {"version": __version__, "data set": dataset.sha256, "effects": chosen, "seed": str(seed), "method": method}


def identified(dataset: Dataset, effects: Sequence[str], seed: int, steps: Steps) -> Run:
    """The three steps, free runs and scores.

    By both methods of step 3 where coloured residuals may be of the air or of the model: then the better free runs of
    flights that no fit has seen decide.
    """
    torch.manual_seed(seed)  # for modules of users that draw; what the package draws has generators of its own
    uniform, monitor = at_one_rate(dataset), steps.monitor
    of_flights = forked(partial(remarks.of_flights, uniform))
    moving = partial(motion_and_forces, uniform, ranks=steps.ranks, device=steps.device)
    reconstruction = steps.reconstruct(tuple(uniform.flights), moving)
    first = steps.do("structure", "structure", lambda: propose(uniform, reconstruction, effects))
    chosen = method_by_quiet_moments(steps.method, uniform, first)

    def judged_by(steps: Steps) -> Run:
        spec, model, regressions, estimate = _best_structure(first, uniform, reconstruction, steps)
        with monitor.step("validate"):
            gusts = smoothed_gusts(model, estimate, uniform, reconstruction, steps.ranks)
            judged = judge(model, dataset, steps.ranks, gusts)
        fit = fit_record(model, spec, estimate, judged)
        report = report_of("identify", uniform, seed, monitor, fit, ())
        return Run(model, spec, fit, report, reconstruction, regressions, estimate, judged.overlays)

    run = judged_by(replace(steps, method=chosen.method, why=chosen.why or steps.why))
    if run.estimate.method == "filter-error" and not chosen.sure:
        calm = replace(steps, method="output-error", why=UNSEEN_BETTER, model=f"{steps.model}calm-")
        run = min(judged_by(calm), run, key=unfed_score)
    run = with_remarks(replace(run, of_flights=of_flights()), uniform)
    if effects:
        with monitor.step("trace"):
            run = with_evidence(run, uniform, effects, seed)
    return replace(run, record=msgspec.structs.replace(run.record, time_s=monitor.time_record()))


def regressed(spec: ModelSpec, dataset: Dataset, reconstruction: Reconstruction) -> tuple[ModelSpec, ModelRegression]:
    """Step 2 of one structure, behind the structure.

    Of a multirotor once more, with less of it, where the first says that a moment is not explained.
    """
    if spec.motors:
        return regressed_rotors(spec, dataset, reconstruction)
    return spec, regress_model(build(spec), dataset, reconstruction)


def estimated(
    spec: ModelSpec, dataset: Dataset, reconstruction: Reconstruction, steps: Steps
) -> tuple[ModelSpec, Model, ModelRegression, ModelEstimate]:
    """Steps 2 and 3 of one structure; once more without a moment whose control power step 3 moves beyond belief."""
    monitor, asked = steps.monitor, "-".join((spec.flapping, *silent_moments(spec)))
    spec, regressions = steps.do("ftr", f"ftr-{asked}", lambda: regressed(spec, dataset, reconstruction))
    model = build(spec)
    monitor.scalars({f"ftr/R2/{row}": float(r.r2) for row, r in regressions.by_row.items()}, 0)
    for line in remarks.regression_table(regressions):
        monitor.log(line)

    names = [n for n in model.parameter_set.free if n not in regressions.held]

    def third() -> ModelEstimate:
        with monitor.fit("-".join((spec.flapping or "fit", *spec.effects))[:80]) as record:
            curves = Curves(record, build(spec), dataset, names)

            def watch(iteration: int, cost: float, theta: Tensor) -> None:
                monitor.scalars({"ml/cost": cost}, iteration)
                if monitor.recorded:
                    curves(iteration, cost, theta)

            means = Means(watch, steps.ranks, steps.device, steps.method, steps.why)
            estimate = estimate_model(model, dataset, reconstruction, regressions, means)
            curves.end(estimate.fit.uncertainty.standard_errors, estimate.fit.minimum.dampings)
            return estimate

    estimate = steps.do("ml", f"ml-{asked}", third)
    model.put(estimate.theta_of(model, regressions))
    monitor.say(f"flapping {spec.flapping}: Akaike's criterion {estimate.criterion:.6g}")
    less = within_belief(spec, model.named_values)
    return (spec, model, regressions, estimate) if less == spec else estimated(less, dataset, reconstruction, steps)


def _best_structure(
    spec: ModelSpec, dataset: Dataset, reconstruction: Reconstruction, steps: Steps
) -> tuple[ModelSpec, Model, ModelRegression, ModelEstimate]:
    """Steps 2 and 3 of a structure, or of its rival where the data prefer that; both by the method of the first."""
    first, other = estimated(spec, dataset, reconstruction, steps), rival(spec)
    if other is None:
        return first
    same = first[3].method
    steps = steps if steps.method == same else replace(steps, method=same, why=first[3].why)
    second = estimated(other, dataset, reconstruction, steps)
    return min(first, second, key=lambda t: t[3].criterion) if second[3].method == same else first


def with_remarks(run: Run, dataset: Dataset) -> Run:
    """The run with what people should know of the flights that the steps saw, of the steps, and of the fit."""
    notes = (
        *run.of_flights,
        *run.reconstruction.notes,
        *remarks.of_controls(dataset, run.regressions.own_share),
        *remarks.of_regressions(run.regressions),
        *remarks.of_estimate(run.estimate, run.fit),
        *limits.of_channels(dataset, run.spec),
        *limits.of_rotors(run.spec, run.fit),
        *limits.of_constants(run.spec, run.fit),
        *limits.of_flapping(run.fit),
    )
    return replace(run, record=msgspec.structs.replace(run.record, warnings=notes))


def refuse(dataset: Dataset, effects: Sequence[str], device: str, method: str = "auto") -> None:
    """Refuse what identify cannot do: effects, a device, a method that are not there, data that no step can use."""
    if method not in METHODS:
        raise InputError("--method", str(method), "there is no such method", ", ".join(METHODS))
    for name in effects:
        if name not in registered():
            wrong = f"there is no such effect{nearest(name, registered())}"
            raise InputError("--effect", name, wrong, f"one of {arguments.listed(sorted(registered()))}")
        if list(effects).count(name) > 1:
            raise InputError("--effect", name, "is named twice", "each effect once")
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device", device, "no CUDA device is available here", "cpu")
    refuse_lacks(dataset)
    others = of_others()
    foreign = [name for name in effects if name in others]
    if foreign:
        refuse_faulty(foreign, propose(with_velocities(dataset), None))
