"""Free runs of models that were identified again: which is best, and whether one is worse by more than chance."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from rotorid_torch.report.records import FlightRecord
from rotorid_torch.report.summary import list_summaries
from rotorid_torch.run.result import Run
from rotorid_torch.trace.terms.settings import SETTINGS
from rotorid_torch.trace.terms.significance import exceeds

DECIDING = ("validate", "identify")
"""Lists whose free runs decide: flights that no fit has seen, and the fitted ones where those are fewer than two, for
one flight does not tell what is chance; never the acid."""
FLOWN_AWAY = 10.0
"""J of a run that has none because its states left all bounds, and the largest that counts: held trim scores 1.

How far away a model flies says nothing more, and one such flight would hide what all the others say.
"""


def best_of(runs: Sequence[Run]) -> Run:
    """The run that describes best the flights which no fit has seen, or without any the fitted; of equals the last."""

    def score(run: Run) -> float:
        judged = {one.name: one.judged for one in list_summaries(run.fit)}
        J = next((judged[n] for n in DECIDING if judged.get(n) is not None), None)
        return math.inf if J is None or math.isnan(J) else J

    return min(reversed(runs), key=score)


def free_run_gain(without: Run, after: Run) -> Tensor:
    """log(J without / J with) of each flight that decides [F]; of two that fly away, or have no score, zero."""
    flown = [_deciding(run) for run in (without, after)]
    scores = [[f.J if f.J_fed is None else f.J_fed for f in flights] for flights in flown]
    J = [[FLOWN_AWAY if one is None or math.isnan(one) else one for one in flights] for flights in scores]
    before, now = torch.tensor(J, dtype=torch.float64).clamp(max=FLOWN_AWAY).log()
    return before - now


def worse(without: Run, after: Run) -> bool:
    """Whether free runs of the flights that decide are worse, in the mean of log J, at the level of the search."""
    return exceeds(-free_run_gain(without, after), 1.0 - SETTINGS.level)


def _deciding(run: Run) -> list[FlightRecord]:
    """Flights of the lists that decide."""
    flights: list[FlightRecord] = []
    for name in DECIDING:
        flights += [f for f in run.fit.flights.values() if f.list == name] if len(flights) < 2 else []
    return flights
