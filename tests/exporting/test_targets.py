"""Models for other tools: each against the model that it was written from, by the tool's own library."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import warnings
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import rotorid_torch as rotorid
from rotorid_torch.cli import main
from rotorid_torch.data import Dataset
from rotorid_torch.errors import InputError
from rotorid_torch.exporting.subject import Subject
from rotorid_torch.exporting.targets import export
from rotorid_torch.model.modes import state_matrix
from tests.exporting.fly import differs
from tests.helpers import shared
from tests.known_models import helicopter, helicopter_spec, points, written

FMU = ("2.0", "3.0")


def subject(**changes) -> Subject:
    return Subject(
        helicopter("first order", **changes), helicopter_spec("first order", **changes), "a model", 0.02, "x"
    )


@pytest.mark.parametrize("fmi", FMU)
def test_an_fmu_is_valid_and_flies_as_the_model_does(fmi: str, run: Path, flights: Dataset, tmp_path: Path):
    validation = pytest.importorskip("fmpy.validation")
    fmu = rotorid.export(run, fmu=tmp_path / "model.fmu", fmi=fmi)["fmu"]
    assert validation.validate_fmu(str(fmu)) == []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the pedals move more than in the flights that were identified
        for start in (0.0, 1.0):
            expected = rotorid.simulate(run, flights["f_ped"], start=start, seconds=None, data=flights)
            found = rotorid.simulate(fmu, flights["f_ped"], start=start, seconds=None, data=flights)
            assert set(found) == set(expected)
            for name, values in expected.items():
                assert np.allclose(found[name], values, rtol=0.0, atol=1e-9), name


@pytest.mark.parametrize("fmi", FMU)
def test_a_tool_that_knows_nothing_of_us_flies_the_fmu(fmi: str, run: Path, tmp_path: Path):
    fmpy = pytest.importorskip("fmpy")
    fmu = rotorid.export(run, fmu=tmp_path / "model.fmu", fmi=fmi)["fmu"]
    model = rotorid.open_run(run).model
    names = {v.name: v for v in fmpy.read_model_description(str(fmu)).modelVariables}
    assert {*model.body.controls, *model.body.outputs, *model.parameter_set.names} <= set(names)
    assert {f"start.{n}" for n in model.layout.names} <= set(names)
    assert all(names[n].causality == "input" for n in model.body.controls)
    still = fmpy.simulate_fmu(str(fmu), stop_time=1.0, step_size=0.02)
    begun = fmpy.simulate_fmu(str(fmu), stop_time=1.0, step_size=0.02, start_values={"start.p": 0.3})
    assert begun["p"][0] == pytest.approx(0.3)
    damped = fmpy.simulate_fmu(
        str(fmu), stop_time=1.0, step_size=0.02, start_values={"start.p": 0.3, "forces.L.p": -50.0}
    )
    assert abs(damped["p"][-1] - still["p"][-1]) < 0.1 * abs(begun["p"][-1] - still["p"][-1])


def test_steps_of_any_length_end_at_the_same_place(run: Path, tmp_path: Path):
    fmpy = pytest.importorskip("fmpy")
    fmu = str(rotorid.export(run, fmu=tmp_path / "model.fmu")["fmu"])
    ends = [
        fmpy.simulate_fmu(fmu, stop_time=1.2, step_size=h, output_interval=h, start_values={"start.p": 0.3})["p"][-1]
        for h in (0.01, 0.04, 0.3)
    ]
    assert np.ptp(ends) < 1e-5 * abs(ends[0])


def test_an_fmu_is_the_same_bytes_and_holds_its_sources(run: Path, tmp_path: Path):
    one, two = (rotorid.export(run, fmu=tmp_path / f"{n}.fmu")["fmu"] for n in "ab")
    assert one.read_bytes() == two.read_bytes()
    names = zipfile.ZipFile(one).namelist()
    assert names[0] == "modelDescription.xml"
    assert {"sources/fmi2.c", "sources/fmu.c"} < set(names)
    assert any(n.startswith("binaries/") for n in names)


@pytest.mark.parametrize("ending", [".json", ".mat"])
def test_a_state_space_has_the_models_eigenvalues_and_derivatives(ending: str, tmp_path: Path):
    given = subject()
    path = export(given, {"statespace": tmp_path / f"system{ending}"})["statespace"]
    if ending == ".json":
        system = json.loads(path.read_text())
        names = system["states"]["name"]
    else:
        from scipy.io import loadmat

        system = loadmat(path, simplify_cells=True)
        names = list(system["states"]["name"])
    assert names == list(given.model.layout.names)
    A = np.array(system["A"])
    expected = np.linalg.eigvals(state_matrix(given.model).numpy())
    assert np.allclose(np.sort_complex(np.linalg.eigvals(A)), np.sort_complex(expected), rtol=0.0, atol=1e-9)
    x, u = given.model.reference_point
    theta, step = given.model.theta.detach(), 1e-6
    for k in range(len(u)):
        shift = torch.zeros_like(u)
        shift[k] = step
        both = [given.model.motion(theta, x, u + s * shift) for s in (1.0, -1.0)]
        for matrix, (plus, minus) in zip(("B", "D"), zip(*both, strict=True), strict=True):
            slope = ((plus - minus) / (2.0 * step)).detach().numpy()
            assert np.allclose(np.array(system[matrix])[:, k], slope, rtol=1e-6, atol=1e-6)


def test_a_delay_stands_in_the_state_space(run: Path, tmp_path: Path):
    system = json.loads(rotorid.export(run, statespace=tmp_path / "s.json")["statespace"].read_text())
    delay = rotorid.open_run(run).model.named_values["control.delay.common"]
    assert system["inputs"]["delay_s"] == pytest.approx([delay] * len(system["inputs"]["name"]))
    assert len(system["inputs"]["unit"]) == len(system["inputs"]["name"])


def test_an_onnx_graph_gives_derivatives_and_outputs(tmp_path: Path):
    runtime = pytest.importorskip("onnxruntime")
    given = subject(effects=("neural.forces", "forces.quadratic_damping"))
    path = export(given, {"onnx": tmp_path / "model.onnx"})["onnx"]
    session = runtime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    x, u = points(given.model, 7)
    rates, outputs = session.run(["rates", "outputs"], {"x": x.numpy(), "u": u.numpy()})
    theta = given.model.theta.detach()
    assert np.allclose(rates, given.model.rates(theta, x, u).detach(), rtol=1e-9, atol=1e-9)
    assert np.allclose(outputs, given.model.outputs_at(theta, x, u).detach(), rtol=1e-9, atol=1e-9)
    facts = session.get_modelmeta().custom_metadata_map
    assert json.loads(facts["states"]) == list(given.model.layout.names)


def test_the_table_has_every_parameter_with_all_its_digits(run: Path, tmp_path: Path):
    with rotorid.export(run, csv=tmp_path / "p.csv")["csv"].open() as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    opened = rotorid.open_run(run)
    assert {n: float(row["value"]) for n, row in rows.items()} == opened.model.named_values
    assert float(rows["forces.L.p"]["standard_error"]) == opened["forces.L.p"].se


def test_the_command_writes_all_targets_at_once(run: Path, tmp_path: Path, capsys):
    places = {"fmu": "m.fmu", "statespace": "s.mat", "onnx": "m.onnx", "c": "c", "csv": "p.csv"}
    words = [w for target, name in places.items() for w in (f"--{target}", str(tmp_path / name))]
    assert main(["export", str(run), *words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {t: str(tmp_path / n) for t, n in places.items()}
    assert all((tmp_path / name).exists() for name in places.values())


@pytest.mark.parametrize(
    ("places", "said"),
    [
        ({}, "names no target"),
        ({"fmu": "model.zip"}, "ends with '.zip'; expected .fmu"),
        ({"statespace": "a.txt"}, ".json or .mat"),
        ({"csv": "missing/p.csv"}, "does not exist"),
        ({"csv": "taken.csv"}, "is in the way"),
        ({"simulink": "a.slx"}, "is no target"),
    ],
)
def test_what_cannot_be_written_is_one_line(places: dict[str, str], said: str, tmp_path: Path):
    (tmp_path / "taken.csv").write_text("mine")
    with pytest.raises(InputError) as refused:
        export(subject(), {t: tmp_path / name for t, name in places.items()})
    assert said in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1
    assert (tmp_path / "taken.csv").read_text() == "mine"


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"csv": 3}, "export: csv: is 3; expected a path"),
        ({"csv": None}, "export: csv: is None; expected a path"),
        ({"csv": "p.csv", "overwrite": "y"}, "export: overwrite: is 'y'; expected True or False"),
        ({"fmu": "p.fmu", "fmi": 2.0}, "is '2.0'"),
    ],
)
def test_arguments_of_another_kind_are_one_line(
    wrong: dict[str, Any], said: str, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as refused:
        rotorid.export(run, **wrong)
    assert said in str(refused.value)


def test_without_a_compiler_the_fmu_is_refused_and_nothing_is_left(tmp_path: Path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(InputError, match="no C compiler was found"):
        export(subject(), {"fmu": tmp_path / "m.fmu"})
    assert list(tmp_path.iterdir()) == []


def test_a_package_that_is_not_installed_is_one_line(run: Path, flights: Dataset, tmp_path: Path, monkeypatch):
    fmu = rotorid.export(run, fmu=tmp_path / "m.fmu")["fmu"]
    for package in ("onnx", "fmpy"):
        monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError, match=r"^\S*/m\.onnx: --onnx: onnx is not installed"):
        rotorid.export(run, onnx=tmp_path / "m.onnx")
    with pytest.raises(InputError, match="fmpy is not installed"):
        rotorid.simulate(fmu, flights["f_ped"], data=flights)


def test_a_file_that_is_no_fmu_is_one_line(flights: Dataset, tmp_path: Path):
    (tmp_path / "m.fmu").write_text("no archive")
    with pytest.raises(InputError, match="an FMU that rotorid export wrote"):
        rotorid.simulate(tmp_path / "m.fmu", flights["f_ped"], data=flights)


def test_the_header_is_one_of_c_plus_plus_too(run: Path, tmp_path: Path):
    folder = rotorid.export(run, c=tmp_path / "c")["c"]
    header = next(folder.glob("*.h"))
    subprocess.run(["g++", "-x", "c++", "-Wall", "-Werror", "-fsyntax-only", str(header)], check=True)


def test_simulate_takes_an_fmu(run: Path, flights: Dataset, tmp_path: Path):
    pytest.importorskip("fmpy")
    fmu = rotorid.export(run, fmu=tmp_path / "m.fmu")["fmu"]
    place = written(flights, tmp_path / "set")
    words = ["simulate", str(fmu), str(place), "--flight", "f_ped", "--out", str(tmp_path / "free.npz"), "--quiet"]
    assert main(words) == 0
    with np.load(tmp_path / "free.npz") as found:
        assert "r" in found.files


SETS = {
    "uh60-hover": (), "uh60-60kt": (), "ah1-hover": (), "uh60b-hover": (), "uh60-delay": ("control.delay",),
    "crazyflie-motors": (),
}  # fmt: skip


@dataclass(frozen=True)
class Measured:
    """A data set of other people, and the model that is identified from it."""

    data: Dataset
    run: rotorid.Run


@pytest.fixture(scope="module", params=SETS)
def measured(request: pytest.FixtureRequest) -> Measured:
    data = rotorid.load(shared("flightdata", request.param))
    return Measured(data, rotorid.identify(data, effects=SETS[request.param]))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:the run leaves the range")
def test_fmus_of_measured_aircraft_fly_as_their_models_do(measured: Measured, tmp_path: Path):
    pytest.importorskip("fmpy")
    data, made = measured.data, measured.run
    flight = data[(data.acid or data.validate)[0]]
    expected = rotorid.simulate(made, flight, seconds=None, data=data)
    for fmi in FMU:
        fmu = made.export(fmu=tmp_path / f"{fmi}.fmu", fmi=fmi)["fmu"]
        found = rotorid.simulate(fmu, flight, seconds=None, data=data)
        assert max(np.abs(found[n] - v).max() for n, v in expected.items()) < 1e-6


@pytest.mark.slow
def test_c_graph_and_state_space_of_measured_aircraft_are_their_models(measured: Measured, tmp_path: Path):
    runtime = pytest.importorskip("onnxruntime")
    model = measured.run.model
    flown = differs(model, tmp_path)
    measured.run.export(onnx=tmp_path / "model.onnx", statespace=tmp_path / "model.json")
    session = runtime.InferenceSession(str(tmp_path / "model.onnx"), providers=["CPUExecutionProvider"])
    x, u = points(model, 7, spread=0.01)
    theta = model.theta.detach()
    graph = session.run(["rates", "outputs"], {"x": x.numpy(), "u": u.numpy()})
    torches = [part.detach().numpy() for part in (model.rates(theta, x, u), model.outputs_at(theta, x, u))]
    apart = max((np.abs(g - t) / (1.0 + np.abs(t))).max() for g, t in zip(graph, torches, strict=True))
    A = np.array(json.loads((tmp_path / "model.json").read_text())["A"])
    poles = [np.sort_complex(np.linalg.eigvals(M)) for M in (A, state_matrix(model).numpy())]
    moved = np.abs(poles[0] - poles[1]).max()
    print(f"C {flown:.1e}, graph {apart:.1e}, eigenvalues {moved:.1e}")
    assert max(flown, apart, moved) < 1e-9
