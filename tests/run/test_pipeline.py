"""The order of the steps: one call from flights to report, the same every time, and bad input told."""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import torch
from rich.console import Console
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams import plugin_data_pb2

import rotorid_torch as rotorid
from rotorid_torch.data import Dataset, load
from rotorid_torch.effects.registry import EFFECTS
from rotorid_torch.errors import InputError
from rotorid_torch.model.rotors import BELIEVED
from rotorid_torch.model.save import load as load_model
from rotorid_torch.model.save import save as save_model
from rotorid_torch.report import records
from rotorid_torch.report.scorecard import scorecard
from rotorid_torch.run import pipeline, saved_model
from rotorid_torch.run.output.folder import refuse_unless_free
from rotorid_torch.run.pipeline import identify
from rotorid_torch.run.result import Run
from rotorid_torch.run.saved_model import Stretch, write_free_run
from tests.effects.own_effects import OwnDrag
from tests.helpers import small_folder
from tests.known_models import STICKS, flown, linear_vehicle, manoeuvres, rate_vehicle, with_values

DT = 0.04
LISTS = {"identify": ["f_lon", "f_lat", "f_col"], "validate": ["f_ped"]}


@pytest.fixture(scope="module")
def data() -> Dataset:
    return flown(rate_vehicle(), manoeuvres(9.0, DT), DT, noise=0.02, lists=LISTS)


@pytest.fixture(scope="module")
def run(data: Dataset, tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Path]:
    out = tmp_path_factory.mktemp("runs") / "run"
    return identify(data, out=out), out


def test_a_run_is_whole(run: tuple[Run, Path]):
    _, out = run
    assert {p.name for p in out.iterdir()} >= {"report.json", "report.html", "model.pt", "reconstruct", "log.txt"}
    assert {p.stem for p in (out / "reconstruct").iterdir()} == {"f_lon", "f_lat", "f_col", "f_ped"}


def test_tensorboard_has_each_fit_by_iteration_and_runs_compare(run: tuple[Run, Path]):
    made, out = run
    fits = [place for place in sorted((out / "tensorboard").iterdir()) if place.is_dir()]
    assert len(fits) == 1
    events = EventAccumulator(str(fits[0])).Reload()
    tags = events.Tags()["scalars"]
    assert {"ml/cost", "ml/step", "ml/damping", "J/validate"} <= set(tags)
    assert {"parameters/forces.L.p", "standard errors/forces.L.p"} <= set(tags)
    assert {e.step for e in events.Scalars("ml/damping")} <= {e.step for e in events.Scalars("ml/cost")}
    assert 0.0 < events.Scalars("J/validate")[0].value < 2.0
    last = events.Scalars("parameters/forces.L.p")[-1].value
    assert last == pytest.approx(made["forces.L.p"].value, rel=1e-5)
    whole = EventAccumulator(str(out / "tensorboard")).Reload()
    assert whole.Scalars("scores/validate")[0].value == pytest.approx(made.scores["validate"], rel=1e-5)
    spectrum = whole.Scalars("spectrum/before/p")
    assert len(spectrum) > 10
    assert all(e.value >= 0.0 for e in spectrum)
    assert [e.step for e in spectrum] == sorted(e.step for e in spectrum)
    content = whole.SummaryMetadata("_hparams_/experiment").plugin_data.content
    experiment = plugin_data_pb2.HParamsPluginData.FromString(content).experiment
    assert {"command", "data set", "effects", "method"} <= {info.name for info in experiment.hparam_infos}
    assert [info.name.tag for info in experiment.metric_infos] == ["scores/identify", "scores/validate"]


def test_report_is_what_the_interface_says(run: tuple[Run, Path], data: Dataset):
    made, out = run
    report = json.loads((out / "report.json").read_text())
    assert report["format"] == 1
    assert report["command"] == "identify"
    assert report["dataset"] == {"name": data.name, "sha256": data.sha256}
    assert report["after"] is None
    assert report["seed"] == 0
    assert report["time_s"]["total"] >= report["time_s"]["ml"] > 0
    fit = report["before"]
    expected = {"method", "method_reason", "gusts", "parameters", "derivatives", "modes", "flights", "scores"}
    assert set(fit) == expected
    assert set(fit["parameters"][0]) == {"name", "value", "se", "unit", "bounds", "at_bound", "status"}
    assert set(fit["flights"]) == set(data.flights)
    assert set(fit["flights"]["f_ped"]["channels"]) == {"p", "q", "r"}
    assert fit["scores"]["acid"] is None
    assert fit["scores"]["identify"] == pytest.approx(
        math.sqrt(np.mean([fit["flights"][n]["J"] ** 2 for n in LISTS["identify"]])), rel=1e-9
    )
    assert fit["scores"]["validate"] == fit["flights"]["f_ped"]["J"] == made.scores["validate"]
    assert records.read_report(out).before == made.fit


def test_scores_of_a_perfect_structure_are_those_of_the_noise(run: tuple[Run, Path]):
    made, _ = run
    for flight in made.fit.flights.values():
        assert flight.J is not None
        assert flight.J_noise is not None
        assert flight.J_noise == pytest.approx(flight.J, rel=0.35)
        assert flight.J_trim is not None
        assert flight.J_trim > 10 * flight.J


def test_the_saved_model_is_the_fitted_one(run: tuple[Run, Path]):
    made, out = run
    loaded, spec = load_model(out / "model.pt")
    assert torch.equal(loaded.theta, made.model.theta)
    assert spec == made.spec


def test_simulate_gives_the_overlay_of_the_report(run: tuple[Run, Path], data: Dataset, tmp_path: Path):
    made, out = run
    found = write_free_run(out, data, "f_lat", tmp_path / "free.npz")
    overlay = next(o for o in made.overlays if o.flight == "f_lat")
    written = np.load(tmp_path / "free.npz")
    for channel in ("p", "q", "r"):
        np.testing.assert_allclose(found[channel][: len(overlay.time)], overlay.model[channel].numpy(), atol=1e-9)
        np.testing.assert_array_equal(written[channel], found[channel])
    assert len(written["time"]) == data.flights["f_lat"].samples
    table = tmp_path / "free.csv"
    write_free_run(out, data, "f_lat", table)
    assert table.read_text().splitlines()[0] == ",".join(found)
    np.testing.assert_allclose(np.loadtxt(table, delimiter=",", skiprows=1).T, list(found.values()), rtol=1e-8)
    with pytest.raises(InputError, match="is no format of a free run"):
        write_free_run(out, data, "f_lat", tmp_path / "free.txt")


def test_simulate_starts_and_ends_where_it_is_told(run: tuple[Run, Path], data: Dataset, tmp_path: Path):
    _, out = run
    found = write_free_run(out / "model.pt", data, "f_lat", tmp_path / "free.npz", Stretch(2.0, 3.0))
    assert found["time"][0] == pytest.approx(2.0)
    assert found["time"][-1] == pytest.approx(5.0)
    late = write_free_run(out, data, "f_lat", tmp_path / "free.npz", Stretch(7.0, 30.0))
    assert late["time"][-1] == pytest.approx(9.0)


@pytest.mark.parametrize(
    ("more", "key"),
    [
        ({"start": 9.0}, "start"),
        ({"start": -1.0}, "start"),
        ({"start": math.nan}, "start"),
        ({"start": math.inf}, "start"),
        ({"seconds": -1.0}, "seconds"),
        ({"seconds": 0.0}, "seconds"),
        ({"seconds": math.nan}, "seconds"),
    ],
)
def test_simulate_refuses_times_outside_the_flight(
    more: dict[str, Any], key: str, run: tuple[Run, Path], data: Dataset, tmp_path: Path
):
    with pytest.raises(InputError) as refusal:
        write_free_run(
            run[1], data, "f_lat", tmp_path / "free.npz", Stretch(**more)
        )  # f_lat was identified from: no warning
    assert refusal.value.key == key
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["dataset.toml", "flights/one.npz", "flights/two.npz", "truth/one.npz"])
def test_simulate_replaces_no_file_of_the_data_set(run: tuple[Run, Path], tmp_path: Path, name: str):
    place = small_folder(tmp_path / "set")
    (place / "truth").mkdir()
    (place / "truth" / "one.npz").touch()
    before = (place / name).read_bytes()
    for more in ({}, {"overwrite": True}):
        with pytest.raises(InputError, match="which is read"):
            write_free_run(run[1], load(place), "one", place / name, **more)
    assert (place / name).read_bytes() == before


def test_simulate_replaces_no_model_that_it_reads(run: tuple[Run, Path], data: Dataset):
    with pytest.raises(InputError, match="which is read"):
        write_free_run(run[1], data, "f_lat", run[1] / "model.pt", overwrite=True)


def test_identify_replaces_its_own_run(run: tuple[Run, Path]):
    refuse_unless_free(run[1], "identify")  # each file of the run is known


def test_simulate_refuses_what_is_not_there(run: tuple[Run, Path], data: Dataset, tmp_path: Path):
    with pytest.raises(InputError, match="no flight 'f_lan'"):
        write_free_run(run[1], data, "f_lan", tmp_path / "free.npz")
    with pytest.raises(InputError, match="no such file"):
        write_free_run(tmp_path / "nowhere", data, "f_lat", tmp_path / "free.npz")
    other = flown(rate_vehicle(), {"f_lat": manoeuvres(3.0, DT)["f_lat"]}, DT)
    channels = other.flights["f_lat"].channels
    fewer = {"f": {c: channels[c] for c in ("time", "p", "q", "lat")} | {"r": 1e-3 * channels["p"]}}
    with pytest.raises(InputError, match="control is missing"):
        write_free_run(run[1], Dataset.from_arrays(fewer, identify=["f"]), "f", tmp_path / "free.npz")


def test_simulate_warns_outside_the_identified_range(run: tuple[Run, Path], tmp_path: Path):
    wild = flown(rate_vehicle(), manoeuvres(3.0, DT, size=0.3), DT)
    with pytest.warns(UserWarning, match=r"leaves the range.*p.*lat"):
        write_free_run(run[1], wild, "f_lat", tmp_path / "free.npz")


def test_simulate_bridges_missing_samples_of_controls(run: tuple[Run, Path], data: Dataset, tmp_path: Path):
    flights = {"f": {c: v.clone() for c, v in data.flights["f_lat"].channels.items()}}
    flights["f"]["col"][20:] = math.nan
    gaps = Dataset.from_arrays(flights, identify=["f"])
    found = write_free_run(run[1], gaps, "f", tmp_path / "free.npz", Stretch(2.0))
    assert np.isfinite(found["p"]).all()


def test_the_same_seed_gives_the_same_numbers(run: tuple[Run, Path], data: Dataset):
    again = identify(data)
    assert torch.equal(again.model.theta, run[0].model.theta)
    assert again.fit == run[0].fit


def test_python_shows_what_the_report_holds(run: tuple[Run, Path], tmp_path: Path):
    made, _ = run
    assert set(made.scores) == {"identify", "validate", "acid"}
    table = made.text().splitlines()
    assert len(table) == len(made.parameters) + 1
    assert made.plot()
    out = made.report(tmp_path / "copy")
    assert (out / "report.json").is_file()
    saved = saved_model.open_run(out)
    again = saved.report(tmp_path / "again")
    pages = [(place / "report.html").read_text() for place in (out, again)]
    assert str(tmp_path) not in pages[0]
    assert pages[1] == pages[0]
    drawn = saved.plot()
    assert sorted(drawn) == sorted(made.plot())
    assert sorted(drawn) == sorted(path.stem for path in (out / "figures").iterdir())
    assert all(figure.images for figure in drawn.values())
    assert load_model(out / "model.pt")[1] == made.spec


def test_identify_is_the_public_name():
    assert rotorid.identify is identify
    assert rotorid.Run is Run


def test_a_list_without_flights_has_no_score():
    few = flown(rate_vehicle(), manoeuvres(4.0, DT), DT, noise=0.02)
    found = identify(few)
    assert found.scores["validate"] is None
    assert found.scores["acid"] is None
    assert found.scores["identify"] is not None


def without_rates(data: Dataset) -> Dataset:
    flights = {n: {c: f.channels[c] for c in ("time", *STICKS)} for n, f in data.flights.items()}
    return Dataset.from_arrays(flights, identify=data.identify)


def test_bad_input_is_told_and_leaves_nothing(data: Dataset, tmp_path: Path):
    out = tmp_path / "run"
    with pytest.raises(InputError, match=r"p: is missing.*body rates"):
        identify(without_rates(data), out=out)
    with pytest.raises(InputError, match=r"--effect: control\.dely.*control\.delay"):
        identify(data, effects=["control.dely"], out=out)
    with pytest.raises(InputError, match=r"--effect: control\.delay.*twice"):
        identify(data, effects=["control.delay", "control.delay"], out=out)
    with pytest.raises(InputError, match="device: is 'tpu'"):
        identify(data, device="tpu", out=out)
    assert not list(tmp_path.iterdir())


def test_a_run_stands_in_nobody_s_way(data: Dataset, tmp_path: Path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.tex").write_text("mine")
    with pytest.raises(InputError):
        identify(data, out=tmp_path / "run")
    assert (tmp_path / "run" / "thesis.tex").read_text() == "mine"


def test_the_method_is_told_and_bad_ones_refused(run: tuple[Run, Path], data: Dataset):
    assert run[0].fit.method == "output-error"
    assert run[0].fit.method_reason.startswith("fitted by output error: no velocities are measured")
    for method, expected in (("guess", "auto, output-error, filter-error"), ("filter-error", "output-error")):
        with pytest.raises(InputError, match=f"--method: {method}.*expected {expected}"):
            identify(data, method=method)


def test_an_own_effect_goes_all_the_way(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setitem(EFFECTS, OwnDrag.id, OwnDrag)
    truth = with_values(linear_vehicle(effects=("own.drag",)), {"own.drag.x": 0.05, "own.drag.y": 0.08})
    data = flown(truth, manoeuvres(8.0, DT, size=0.08), DT, noise=0.01, seed=2)
    made = identify(data, effects=["own.drag"], out=tmp_path / "run")
    found = {p.name: p for p in made.parameters}
    for axis, value in (("x", 0.05), ("y", 0.08)):
        drag = found[f"own.drag.{axis}"]
        assert drag.value is not None
        assert drag.se is not None
        assert abs(drag.value - value) < 3.5 * drag.se
        assert drag.value > 3.0 * drag.se
    record = records.read_report(tmp_path / "run").effects
    assert [(e.id, e.role, e.verdict) for e in record] == [("own.drag", "undeclared", "accepted")]
    assert {p.name for p in record[0].parameters} == {"own.drag.x", "own.drag.y", "own.drag.z"}
    shown = io.StringIO()
    Console(file=shown, width=200).print(scorecard(made.record))
    assert "own.drag earns its place: flights that no fit has seen" in shown.getvalue()
    loaded, _ = load_model(tmp_path / "run" / "model.pt")
    assert loaded.effect("own.drag") is not None
    monkeypatch.delitem(EFFECTS, OwnDrag.id)
    with pytest.raises(InputError, match=r"model\.pt.*own\.drag"):
        load_model(tmp_path / "run" / "model.pt")


def test_reconstruct_alone_writes_a_run(data: Dataset, tmp_path: Path):
    found = pipeline.reconstruct(data, tmp_path / "run")
    held = np.load(tmp_path / "run" / "reconstruct" / "f_lon.npz")
    np.testing.assert_allclose(held["p"], found.flights["f_lon"].channels["p"].numpy())
    assert json.loads((tmp_path / "run" / "report.json").read_text())["before"] is None


def test_a_model_that_diverges_is_simulated(run: tuple[Run, Path], data: Dataset, tmp_path: Path):
    wild = load_model(run[1] / "model.pt")[0]
    wild.theta.data[wild.parameter_set.index("forces.L.q")] = 1e3
    wild.theta.data[wild.parameter_set.index("forces.M.p")] = 1e3
    save_model(wild, run[0].spec, tmp_path / "model.pt")
    with pytest.warns(UserWarning, match="leaves the range"):
        found = write_free_run(tmp_path / "model.pt", data, "f_lat", tmp_path / "free.npz")
    assert np.isfinite(found["p"]).all()


def test_a_control_power_that_step_3_moves_beyond_belief_is_held():
    flights = ["roll_p", "pitch_p", "thrust_p"]
    lag = [("propulsion.motor_lag", 1.0)]  # without it in the model the steps differ about roll
    data = rotorid.fly(None, vehicle="quad", flights=flights, effects=lag, seconds=5.0).dataset()
    assert data.vehicle.inertia is not None
    run = identify(data)
    third = run.model.named_values["rotors.power.L"]
    run.model.put(run.regressions.theta)
    second = run.model.named_values["rotors.power.L"]
    assert third < second
    heavier = BELIEVED[0] / math.sqrt(second * third)  # the limit lies between the two for a body of such an inertia
    inertia = tuple(tuple(heavier * j for j in row) for row in data.vehicle.inertia)
    run = identify(replace(data, vehicle=msgspec.structs.replace(data.vehicle, inertia=inertia)))
    powers = {n: v for n, v in run.model.named_values.items() if n.startswith("rotors.power")}
    assert powers["rotors.power.L"] == 0.0
    assert all(v == 0.0 or BELIEVED[0] < v < BELIEVED[1] for v in powers.values())
