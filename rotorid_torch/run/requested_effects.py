"""Whether the effects that `identify --effect` was asked for earned their place: records for the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import msgspec

from rotorid_torch.core.processes.ranks import ALONE
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.run.estimate import estimated
from rotorid_torch.run.loop_record import effect_record
from rotorid_torch.run.output.checkpoint import Checkpoint, Steps
from rotorid_torch.run.output.monitor import Monitor
from rotorid_torch.run.result import Run
from rotorid_torch.trace.candidates import untried
from rotorid_torch.trace.earned import earned
from rotorid_torch.trace.fits import Flights, refit
from rotorid_torch.trace.multirotor import Identified, rotors_earned


def with_evidence(run: Run, dataset: Dataset, effects: Sequence[str], seed: int) -> Run:
    """The run with a record of each effect that was asked for.

    dataset : as the steps saw it. seed : of the residuals that say what chance explains.
    """
    if run.spec.motors:
        quiet = Steps(Monitor(), kept=Checkpoint(), ranks=ALONE)

        def fit(spec: ModelSpec) -> Identified:
            _, model, _, estimate = estimated(spec, dataset, run.reconstruction, quiet)
            return Identified(spec, model, dict(zip(estimate.names, estimate.fit.errors.tolist(), strict=True)))

        findings = rotors_earned(fit(run.spec), dataset, fit, effects, seed)
    else:
        flights, held = Flights(dataset, run.reconstruction), run.regressions.held
        findings = earned(refit(run.spec, flights, run.model.named_values, held), effects, held, seed)
    record = msgspec.structs.replace(
        run.record,
        effects=tuple(effect_record(f, run.model, run) for f in findings),
        warnings=(*run.record.warnings, *untried(dataset)),
    )
    return replace(run, record=record)
