"""The built-in aircraft flies, the three steps identify it, and the model predicts a flight it has not seen."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from rotorid_torch.data import Dataset
from rotorid_torch.identification import model_estimation
from rotorid_torch.model.save import load
from rotorid_torch.run.pipeline import identify
from rotorid_torch.run.result import Run
from rotorid_torch.run.saved_model import write_free_run
from rotorid_torch.simulation.flight_test import fly

FLIGHTS = ("f321_lon", "f321_lat", "f321_col", "f321_ped", "dbl_lon_n")


@pytest.fixture(scope="module")
def data() -> Dataset:
    """Five flights at a third of the sample rate: free runs cost a third."""
    flown = fly(None, flights=FLIGHTS, seconds=7.0)
    thin = {name: {c: v[::3] for c, v in channels.items()} for name, channels in flown.flights.items()}
    tables = {key: flown.declaration[key] for key in ("kind", "vehicle", "controls", "channels")}
    return Dataset.from_arrays(thin, **flown.declaration["flights"], **tables)


@pytest.fixture(scope="module", params=["hurried", pytest.param("whole", marks=pytest.mark.slow)])
def run(
    request: pytest.FixtureRequest, data: Dataset, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Run, Path, float]:
    """The run, its folder and processor time; hurried: step 3 ends after a few iterations on short segments."""
    out = tmp_path_factory.mktemp("runs") / "run"
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "hurried":
            patch.setattr(model_estimation, "LENGTHS", (2.0,))
            patch.setattr(model_estimation, "STEP_3", replace(model_estimation.STEP_3, max_iterations=4))
        begin = time.process_time()
        made = identify(data, out=out)
        return made, out, time.process_time() - begin


def test_the_model_beats_holding_trim_on_a_flight_it_has_not_seen(run: tuple[Run, Path, float]):
    made, _, _ = run
    unseen = made.fit.flights["dbl_lon_n"]
    assert unseen.list == "validate"
    assert unseen.J is not None
    assert unseen.J_trim is not None
    assert unseen.J < 0.5 * unseen.J_trim
    assert made.scores["identify"] is not None
    assert made.scores["identify"] < 0.3
    assert made.scores["acid"] is None


def test_rotor_and_physics_of_the_declaration_are_in_the_model(run: tuple[Run, Path, float]):
    made, _, _ = run
    assert made.spec.flapping == "first order"
    assert made.spec.inflow
    assert {"u", "p", "a0", "a1", "b1", "vi"} <= set(made.model.layout.names)
    assert {"ax", "a1"} <= set(made.fit.flights["dbl_lon_n"].channels)


def test_derivatives_have_the_signs_of_a_helicopter(run: tuple[Run, Path, float]):
    """Main controls in the flapping's rows or the body's: collective lifts, and the rotor damps roll and pitch."""
    made, _, _ = run
    real = [m.eigenvalue[0] for m in made.fit.modes]
    assert min(r for r in real if r is not None) < -1.0
    value = {p.name: p.value for p in made.parameters}
    assert value["forces.Z.trim"] == pytest.approx(-9.8, abs=0.5)
    assert all(v is not None and math.isfinite(v) for v in value.values())
    assert torch.equal(made.model.parameter_set.clamp(made.model.theta.detach()), made.model.theta.detach())


def test_simulate_from_the_run_is_the_report_s_free_run(run: tuple[Run, Path, float], data: Dataset, tmp_path: Path):
    made, out, _ = run
    overlay = next(o for o in made.overlays if o.flight == "f321_lat")
    found = write_free_run(out, data, "f321_lat", tmp_path / "free.npz")
    for channel in ("p", "v", "theta", "a1"):
        free = overlay.model[channel].numpy()
        assert found[channel] == pytest.approx(free[: len(found[channel])], abs=1e-6)
    assert load(out / "model.pt")[1] == made.spec


def test_it_takes_less_than_two_minutes_of_one_processor(run: tuple[Run, Path, float]):
    assert run[2] < 120.0
