"""From a fitted model to the FIT of the report: parameters, modes, free runs and their scores on every flight."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import torch
from torch import Tensor

from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.velocities.positions import HALF
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.gusts import Histories
from rotorid_torch.identification.model_estimation import ModelEstimate
from rotorid_torch.model.derivatives import LinearForces
from rotorid_torch.model.model import Model
from rotorid_torch.model.modes import modes, settled_derivatives
from rotorid_torch.model.nominal import derivative_unit
from rotorid_torch.report.overlay import Overlay
from rotorid_torch.report.records import (
    LISTS,
    ChannelRecord,
    FitRecord,
    FlightRecord,
    GustRecord,
    ModeRecord,
    ParameterRecord,
    ScoresRecord,
    Status,
)
from rotorid_torch.report.summary import SHOWN
from rotorid_torch.validate import scores
from rotorid_torch.validate.free_run import Runs, Windows
from rotorid_torch.validate.gusts import in_gusts
from rotorid_torch.validate.neighbours import free_run_bands, without
from rotorid_torch.validate.predictions import predictions
from rotorid_torch.validate.responses import compared, least_motion, responses
from rotorid_torch.validate.windows import ScoredChannels, all_windows


@dataclass(frozen=True)
class Judged:
    """Free runs of all flights: their record for the report, and their overlays for the pictures."""

    flights: Mapping[str, FlightRecord]
    scores: ScoresRecord
    overlays: tuple[Overlay, ...]


def for_pictures(
    overlays: Sequence[Overlay], model: Model, dataset: Dataset, estimate: ModelEstimate, effects: Sequence[str]
) -> tuple[Overlay, ...]:
    """Flights that no fit has seen, with the errors of the parameters and with what each of these effects does."""
    by_step = defaultdict[float, list[str]](list)
    for overlay in overlays:
        if overlay.list != "identify":
            by_step[dataset.facts[overlay.flight].dt].append(overlay.flight)
    bands, bare = dict[str, dict[str, Tensor]](), defaultdict[str, dict[str, dict[str, Tensor]]](dict)
    for flights in by_step.values():
        if dataset.kind != "multirotor":
            bands |= free_run_bands(model, dataset, flights, estimate.names, estimate.fit.uncertainty.covariance)
        for effect in effects:
            for flight, channels in without(model, dataset, flights, effect).items():
                bare[flight][effect] = channels
    return tuple(replace(o, band=bands.get(o.flight, {}), without=bare.get(o.flight, {})) for o in overlays)


def fit_record(model: Model, spec: ModelSpec, estimate: ModelEstimate, judged: Judged) -> FitRecord:
    """FIT of a model that step 3 estimated and `judge` ran."""
    axes = () if estimate.air is None else estimate.air.axes
    return FitRecord(
        method="filter-error" if estimate.method == "filter-error" else "output-error",
        method_reason=estimate.why,
        gusts=tuple(GustRecord(**vars(axis)) for axis in axes),
        parameters=parameter_records(model, estimate),
        derivatives=_derivatives(model, spec, estimate),
        modes=tuple(
            ModeRecord(eigenvalue=(m.eigenvalue.real, m.eigenvalue.imag), name=m.name) for m in modes(model, spec.sizes)
        ),
        flights=dict(judged.flights),
        scores=judged.scores,
    )


def _derivatives(model: Model, spec: ModelSpec, estimate: ModelEstimate) -> tuple[ParameterRecord, ...]:
    """Derivatives with the rotor settled, of a model that has derivatives."""
    if model.effect(LinearForces.id) is None:
        return ()
    settled = settled_derivatives(model, estimate.names, estimate.fit.uncertainty.covariance)
    units = {d.name: derivative_unit(spec, *d.name.split(".")) for d in settled}
    return tuple(ParameterRecord(name=d.name, value=d.value, se=d.se, unit=units[d.name]) for d in settled)


def parameter_records(model: Model, estimate: ModelEstimate) -> tuple[ParameterRecord, ...]:
    """Every parameter of the model; those that step 3 left alone are frozen.

    One that the data do not tell, or that a bound holds, has no standard error.
    """
    minimum, se = estimate.fit.minimum, estimate.fit.uncertainty.standard_errors
    place = {name: i for i, name in enumerate(estimate.names)}
    records = []
    for k, declared in enumerate(model.parameter_set.parameters):
        i = place.get(declared.name)
        blind = i is not None and bool(minimum.not_identifiable[i])
        bound = i is not None and bool(minimum.at_bound[i])
        estimated: Status = "nuisance" if declared.nuisance else "not identifiable" if blind else "free"
        records.append(
            ParameterRecord(
                name=declared.name,
                value=float(model.theta.detach()[k]),
                se=0.0 if i is None else None if blind or bound else float(se[i]),
                unit=declared.unit,
                bounds=declared.bounds,
                at_bound=bound,
                status="frozen" if i is None else estimated,
            )
        )
    return tuple(records)


def judge(model: Model, dataset: Dataset, ranks: Ranks = ALONE, gusts: Histories | None = None) -> Judged:
    """Free runs over 8 s at every whole second of every flight, and their scores as the interface defines them.

    Overlays are those of the first flights of each list, `SHOWN` of them. The flights are spread over the ranks; each
    gets all records. gusts : of the flights, whose records then say what these do to the free runs.
    """
    records, overlays = dict[str, FlightRecord](), dict[str, Overlay]()
    shown = {name for flights in (dataset.identify, dataset.validate, dataset.acid) for name in flights[:SHOWN]}
    run, multirotor = Runs.of(model), dataset.kind == "multirotor"
    least = least_motion(dataset) if multirotor else {}
    for name, piece, outputs in all_windows(model, dataset, ranks.mine(tuple(dataset.flights)), run):
        records[name] = _flight(model, dataset, name, piece, outputs)
        if multirotor:
            records[name] = _without_free_run(run, dataset, name, records[name], least)
        if name in shown:
            free = (piece, outputs)
            overlays[name] = _accelerations(model, dataset, name) if multirotor else _overlay(model, dataset, *free)
    for others, pictures in ranks.gather((records, overlays)):
        records, overlays = records | others, overlays | pictures
    ordered, J = {name: records[name] for name in dataset.flights}, defaultdict(list)
    for record in ordered.values():
        J[record.list].append(record.J if record.J is not None else torch.nan)
    for name, changed in in_gusts(model, dataset, gusts) if gusts else ():
        ordered[name] = msgspec.structs.replace(ordered[name], **changed)
    totals = {k: float(scores.list_score(torch.tensor(J[k], dtype=torch.float64))) if J[k] else None for k in LISTS}
    return Judged(ordered, ScoresRecord(**totals), tuple(overlays[name] for name in ordered if name in overlays))


def _flight(model: Model, dataset: Dataset, name: str, piece: Windows, outputs: Tensor) -> FlightRecord:
    scored = ScoredChannels.of(model, dataset)
    channels = _channels(model, piece, outputs)
    J, first = scored.J(piece, outputs), piece.measured[0][:, scored.places]
    return FlightRecord(
        list=dataset.listed(name),
        J=float(J[0]),
        J_noise=float(scores.noise_J(first, scored.noise, scored.scale)),
        J_trim=float(scores.trim_J(first, scored.scale, piece.dt)),
        windows=scores.window_statistics(J),
        channels={c: record for c, record in channels.items() if c not in dataset.derived},
    )


def _without_free_run(
    run: Runs, dataset: Dataset, name: str, record: FlightRecord, least: Mapping[str, float]
) -> FlightRecord:
    """The record with what tells of a multirotor's model, whose free runs drift: responses and short predictions.

    Velocities that were made from positions before and after judge nothing, and no position while that is known.
    """
    flight = dataset.flights[name]
    explained = responses(run.model, flight, least=least)
    ahead = tuple(
        p
        for p in predictions(run.model, flight, run)
        if not dataset.derived
        or not (p.quantity == "velocity" or (p.quantity == "position" and p.seconds < 2.0 * HALF))
    )
    return msgspec.structs.replace(record, responses=explained, predictions=ahead)


def _channels(model: Model, piece: Windows, outputs: Tensor) -> dict[str, ChannelRecord]:
    measured, run = piece.measured[0], outputs[0]
    error, theil = run - measured, scores.theil(run, measured, piece.dt)
    rmse, r2 = scores.rmse(error), scores.r2(error, measured)
    return {
        channel: ChannelRecord(
            rmse=float(rmse[i]),
            r2=float(r2[i]),
            theil=float(theil.coefficient[i]),
            theil_parts=(float(theil.parts[i, 0]), float(theil.parts[i, 1]), float(theil.parts[i, 2])),
        )
        for i, channel in enumerate(model.body.outputs)
        if not bool(measured[:, i].isnan().all())
    }


def _overlay(model: Model, dataset: Dataset, piece: Windows, outputs: Tensor) -> Overlay:
    columns = lambda values: dict(zip(model.body.outputs, values.clone().unbind(-1), strict=True))  # noqa: E731
    name, time = piece.names[0], piece.dt * torch.arange(outputs.shape[1], dtype=torch.float64)
    record = Overlay(name, dataset.listed(name), time, columns(piece.measured[0]), columns(outputs[0]))
    return _with_controls(record, dataset, piece.starts[0])


def _accelerations(model: Model, dataset: Dataset, name: str) -> Overlay:
    """What the model of a multirotor makes of measured states beside what was measured, less a constant each."""
    pairs, dt = compared(model, dataset.flights[name]), dataset.flights[name].dt
    measured, modelled = ({c: pair[k] for c, pair in pairs.items()} for k in (0, 1))
    level = {c: m + (measured[c] - m).nanmean() for c, m in modelled.items()}
    samples = len(next(iter(pairs.values()))[0]) if pairs else 0
    first = (dataset.flights[name].samples - samples) // 2
    time = dt * torch.arange(first, first + samples, dtype=torch.float64)
    record = Overlay(name, dataset.listed(name), time, measured, level, integrated=False)
    return _with_controls(record, dataset, first)


def _with_controls(overlay: Overlay, dataset: Dataset, first: int) -> Overlay:
    """The overlay with the controls from sample `first` on, and the noise of its channels."""
    flight, samples = dataset.flights[overlay.flight], len(overlay.time)
    controls = {c: flight.bridged([c])[first : first + samples, 0] for c in dataset.controls if flight.has(c)}
    units = {c: dataset.control_specs[c].unit for c in controls}
    noise = {c: dataset.noise(c) for c in overlay.measured if overlay.integrated}
    return replace(overlay, controls=controls, units=units, noise=noise)
