"""Every experiment runs from its command line in its quick form, and its last line is one JSON object."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers import ROOT

pytest.importorskip("tyro", reason="experiments need the extra 'experiments'")


def quick(name: str, out: Path, *arguments: str) -> dict:
    command = [sys.executable, str(ROOT / "experiments" / f"{name}.py"), "--quick", *arguments]
    done = subprocess.run(
        command, cwd=out, env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow
def test_paper_case_study_draws_the_papers_figures_and_follows_unseen_flights(tmp_path: Path) -> None:
    result = quick("paper_case_study", tmp_path, "--out", str(tmp_path / "study"))
    drawn = {file.stem for file in (tmp_path / "study").glob("*.png")}
    wanted = {"figure4_forces", "figure5_flapping_driven", "figure6_moments", "figure7_velocities_sweep_col"}
    assert wanted | {"figure8_rates_sweep_col", "figure9_rotor_sweep_col"} <= drawn
    assert list((tmp_path / "study" / "tensorboard").iterdir())
    assert min(min(flight.values()) for flight in result["step 1: truth within 3 sigma"].values()) > 0.9
    assert result["step 2: R2 of flapping along the flown motion"]["dbl_lon_n"]["a1"] > 0.95
    assert result["step 3: R2 of moments along the flown motion"]["dbl_lon_n"]["M"] > 0.9
    assert result["J"]["acid"] < 0.5


def test_chain_coverage_holds_the_truth_and_continues_where_it_stopped(tmp_path: Path) -> None:
    first = quick("studies/coverage_chain", tmp_path, "--out", str(tmp_path / "chain"))["chain"]
    assert first["runs"] == 1
    assert first["intervals_missing"] == 0
    assert first["pooled"] > 0.8
    with next((tmp_path / "chain").glob("*.jsonl")).open("a", encoding="utf-8") as file:
        file.write('{"run": 1, "fou')  # as a killed run leaves it
    again = quick("studies/coverage_chain", tmp_path, "--out", str(tmp_path / "chain"))["chain"]
    assert again["pooled"] == first["pooled"]
    assert again["seconds"] < 0.5 * first["seconds"]


@pytest.mark.slow
def test_coverage_of_single_steps_is_in_reach_of_95_percent(tmp_path: Path) -> None:
    result = quick("studies/coverage", tmp_path, "--logdir", str(tmp_path / "steps"))
    assert all(step["pooled"] > 0.8 for step in result.values())


def test_a_textbooks_case_in_turbulence_is_within_its_errors(tmp_path: Path) -> None:
    result = quick("studies/textbook_cases", tmp_path)
    assert result["converged"] == result["runs"] == 2
    assert result["within 2.5 errors"] > 0.9


@pytest.mark.slow
def test_turbulence_and_what_no_method_mends(tmp_path: Path) -> None:
    ratio = quick("studies/identify_in_gusts", tmp_path)["J over calm"]
    assert 1.0 < ratio["best"] < ratio["gusts"] * 1.5
    assert ratio["same air"] < 4.0


@pytest.mark.slow
def test_a_simulators_flights_are_followed_better_than_by_holding_trim(tmp_path: Path) -> None:
    scores = quick("other_simulators", tmp_path)["built-in"]
    assert scores["J_noise"] < scores["J"] < 0.5 * scores["J_trim"]
    assert (tmp_path / "runs" / "other_simulators" / "built-in" / "report.html").exists()


@pytest.mark.slow
def test_another_groups_multirotor_is_flown_where_its_simulator_is_installed(tmp_path: Path) -> None:
    pytest.importorskip("rotorpy")
    line = quick("studies/rotorpy_flights", tmp_path, "--record", str(tmp_path / "lines.jsonl"))
    assert set(line["named"]) <= {"propulsion.motor_lag", "control.delay"}


@pytest.mark.slow
def test_a_helicopter_of_jsbsim_is_flown_where_that_is_installed(tmp_path: Path) -> None:
    pytest.importorskip("jsbsim")
    assert quick("studies/jsbsim_flights", tmp_path)["J"] < 0.3


@pytest.mark.slow
def test_the_study_of_steady_wind_says_which_way_it_blows(tmp_path: Path) -> None:
    line = quick("studies/steady_wind", tmp_path)
    assert line["outcome"] == "missed" or line["direction_off"] < 20.0
