"""A report and free runs as a pipeline would make them, small and with every kind of entry."""

from __future__ import annotations

import math

import pytest
import torch

from rotorid_torch.report import records
from rotorid_torch.report.overlay import Overlay

CHANNELS = ("u", "v", "w", "p", "q", "r", "phi", "theta", "a0", "a1", "b1")


def a_flight(name: str, J: float) -> records.FlightRecord:
    channel = records.ChannelRecord(rmse=0.1 * J, r2=1 - J * J, theil=0.4 * J, theil_parts=(0.2, 0.3, 0.5))
    windows = records.WindowsRecord(median=J, p10=0.8 * J, p90=1.5 * J)
    channels = dict.fromkeys(CHANNELS[:8], channel)
    return records.FlightRecord(list=name, J=J, J_noise=0.06, J_trim=1.0, windows=windows, channels=channels)


@pytest.fixture(scope="session")
def fit() -> records.FitRecord:
    parameters = (
        records.ParameterRecord(name="forces.L.p", value=-3.2, se=0.05, unit="1/s", bounds=(-20.0, 0.0)),
        records.ParameterRecord(name="forces.M.q", value=0.0, se=0.2, unit="1/s", bounds=(-9.0, 0.0), at_bound=True),
        records.ParameterRecord(name="forces.N.u", value=0.1, se=math.inf, unit="1/m", status="not identifiable"),
        records.ParameterRecord(name="bias.p.f1", value=0.01, se=0.001, unit="rad/s", status="nuisance"),
    )
    modes = (
        records.ModeRecord(eigenvalue=(0.11, 0.42), name="phugoid"),
        records.ModeRecord(eigenvalue=(-3.3, 0.0), name="roll subsidence"),
    )
    flights = {"f1": a_flight("identify", 0.08), "f2": a_flight("validate", 0.15), "sweep": a_flight("acid", 0.12)}
    scores = records.ScoresRecord(identify=0.08, validate=0.15, acid=0.12)
    settled = (
        records.ParameterRecord(name="L.p", value=-4.1, se=0.2, unit="1/s"),
        records.ParameterRecord(name="M.p", value=0.1, se=0.3, unit="1/s"),
    )
    return records.FitRecord(parameters=parameters, derivatives=settled, modes=modes, flights=flights, scores=scores)


@pytest.fixture(scope="session")
def report(fit: records.FitRecord) -> records.Report:
    return records.Report(
        command="identify",
        dataset=records.DatasetRecord(name="<uh60> & hover", sha256="ab" * 32),
        seed=3,
        time_s=records.TimeRecord(reconstruct=1.5, total=20.0),
        peak_memory_mb=812.0,
        before=fit,
        warnings=("the flight f2 has no height",),
    )


def an_overlay(name: str, flight: str = "sweep", shift: float = 0.05) -> Overlay:
    time = torch.arange(300, dtype=torch.float64) / 25
    measured = {channel: torch.sin(time * (1 + k / 5)) for k, channel in enumerate(CHANNELS)}
    measured["p"] = measured["p"].clone()
    measured["p"][40:60] = math.nan
    model = {channel: torch.sin((time - shift) * (1 + k / 5)) for k, channel in enumerate(CHANNELS)}
    return Overlay(flight, name, time, measured, model)


@pytest.fixture(scope="session")
def overlays() -> list[Overlay]:
    return [an_overlay("validate", "dbl_lon_n"), an_overlay("validate", "dbl_lat_n"), an_overlay("acid")]
