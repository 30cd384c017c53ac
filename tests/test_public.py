"""What a user meets in Python: public names, short answers, parameters by name, runs that are opened again."""

from __future__ import annotations

import copy
import inspect
import json
import pickle
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch
from torch import Tensor, nn

import rotorid_torch as rotorid
from rotorid_torch.cli import main
from rotorid_torch.data import Dataset
from rotorid_torch.errors import InputError
from rotorid_torch.run.result import Run
from tests.known_models import flown, manoeuvres, rate_vehicle, written

DT = 0.04
LONGEST = 2000


@pytest.fixture(scope="module")
def data() -> Dataset:
    lists = {"identify": ["f_lon", "f_lat", "f_col"], "validate": ["f_ped"]}
    return flown(rate_vehicle(), manoeuvres(9.0, DT), DT, noise=0.02, lists=lists)


@pytest.fixture(scope="module")
def run(data: Dataset, tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Path]:
    out = tmp_path_factory.mktemp("runs") / "run"
    return rotorid.identify(data, out=out), out


class Lag(nn.Module):
    """dx/dt = a x + b u."""

    def __init__(self) -> None:
        super().__init__()
        self.a, self.b = (nn.Parameter(torch.tensor(v, dtype=torch.float64)) for v in (-1.0, 1.0))

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        return self.a * x + self.b * u

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        return x


def response() -> dict[str, np.ndarray]:
    """The exact answer to a step with a = -2, b = 3, and a little noise."""
    time = np.arange(0.0, 4.0, 0.02)
    x = 1.5 * (1.0 - np.exp(-2.0 * time)) + 1e-3 * np.random.default_rng(0).standard_normal(len(time))
    return {"time": time, "controls": np.ones((len(time), 1)), "outputs": x[:, None], "x0": np.zeros(1)}


def test_the_public_names_are_listed_and_nothing_else():
    assert dir(rotorid) == sorted([*rotorid.__all__, "__version__"])
    assert all(not n.startswith("_") for n in rotorid.__all__)
    for name in rotorid.__all__:
        thing = getattr(rotorid, name)
        assert inspect.isclass(thing) or inspect.isfunction(thing) or inspect.ismodule(thing)
        assert thing.__doc__
    assert rotorid.__version__[0].isdigit()


def test_a_name_that_is_not_there_is_answered_with_the_nearest():
    with pytest.raises(AttributeError, match="did you mean 'identify'"):
        _ = rotorid.identfy  # pyright: ignore[reportAttributeAccessIssue]


def test_answers_are_short(run: tuple[Run, Path], data: Dataset):
    fitted = rotorid.output_error(Lag(), [response()], free=["a", "b"], x0="fixed")
    regressed = rotorid.regress(torch.randn(400).double(), torch.randn(400, 2).double(), 0.02, band=(0.1, 2.0))
    followed = rotorid.filter_error(Lag(), [response()], x0="fixed", max_iterations=1)
    whole = (
        run[0],
        rotorid.open_run(run[1]),
        run[0].fit,
        run[0].record,
        run[0].model,
        data,
        data["f_ped"],
        rotorid.check(data),
        run[0].reconstruction,
        run[0].regressions,
        run[0].estimate,
        *run[0].overlays,
        *data.facts.values(),
        data.windows(2.0),
        rotorid.fly(None, flights=["f321_lon"], seconds=1.0),
    )
    flown_free = run[0].model.free_run(data["f_ped"], (0.0, 1.0), 2.0)
    for thing in (*whole, flown_free, fitted, followed, fitted.uncertainty, regressed):
        assert 20 < len(repr(thing)) <= LONGEST, type(thing)


def test_every_result_is_a_table_a_picture_a_dict_and_answers_by_name(run: tuple[Run, Path], data: Dataset):
    checked = rotorid.check(data)
    by_name = {
        "L.p": (run[0], rotorid.open_run(run[1])),
        "a": (
            rotorid.output_error(Lag(), [response()], free=["a"], x0="fixed"),
            rotorid.filter_error(Lag(), [response()], x0="fixed", max_iterations=1),
        ),
        "1": (rotorid.regress(torch.randn(400).double(), torch.randn(400, 2).double(), 0.02),),
        "p": (checked,),
    }
    for name, results in by_name.items():
        for result in results:
            assert result[name].name.endswith(name)
            assert name in str(result.table())
            assert result.plot()
            assert json.loads(msgspec.json.encode(result.to_dict()))
            assert "<table>" in result._repr_html_()
    with pytest.raises(KeyError, match="no channel 'P'"):
        checked["P"]
    assert checked["p"].verdict == checked.to_dict()["channels"][[c.name for c in checked].index("p")]["verdict"]
    assert set(run[0].reconstruction.plot()) == {flight.name for flight in data}


def test_parameters_are_there_by_name(run: tuple[Run, Path]):
    made, _ = run
    whole = next(p.name for p in made.parameters if p.name.endswith(".L.lat"))
    settled = next(d for d in made.fit.derivatives if d.name == "L.lat")
    assert made["L.lat"] is settled
    assert made[whole] is made["forces.L.lat"] is not settled
    assert made.to_dict()[whole]["value"] == made[whole].value
    assert whole in made._repr_html_()
    assert [p.name for p in made] == list(made.to_dict())
    assert "L.lat" in made
    assert "L.latt" not in made
    with pytest.raises(KeyError, match="did you mean"):
        made["L.latt"]
    with pytest.raises(KeyError, match=r"did you mean L\.lat\?"):
        made["Llat"]


def test_output_error_answers_by_name_too():
    fitted = rotorid.output_error(Lag(), [response()], free=["a", "b"], x0="fixed")
    assert fitted["a"].value == pytest.approx(-2.0, abs=4.0 * fitted["a"].se)
    assert fitted["b"].value == pytest.approx(3.0, abs=4.0 * fitted["b"].se)
    assert fitted.text().splitlines()[1].startswith("a ")


def test_a_run_that_is_opened_says_what_the_run_said(run: tuple[Run, Path]):
    made, out = run
    opened = rotorid.open_run(out)
    assert repr(rotorid.Run.load(out)) == repr(opened)
    assert opened.scores == made.scores
    assert opened.parameters == made.parameters
    assert opened.model.named_values == made.model.named_values
    assert opened.verdict is None
    assert opened.spec == made.spec


def test_a_model_that_was_trained_in_torch_is_exported_with_its_run(run: tuple[Run, Path], tmp_path: Path):
    opened = rotorid.open_run(run[1])
    trained = opened.with_effects("control.delay")
    with torch.no_grad():
        trained.theta += 0.01
    trained.start_from({})
    opened.export(model=trained, csv=tmp_path / "trained.csv", statespace=tmp_path / "trained.json")
    rows = {row.split(",")[0]: row.split(",")[1:3] for row in (tmp_path / "trained.csv").read_text().splitlines()}
    assert rows["control.delay.common"] == [repr(trained.named_values["control.delay.common"]), ""]
    with pytest.raises(InputError, match=r"run: is a Model; expected its Run, and model=MODEL beside it"):
        rotorid.export(trained, csv=tmp_path / "b.csv")  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="model: is of another run"):
        rotorid.export(run[0], model=rotorid.Model(trained.body, [], {}), csv=tmp_path / "b.csv")
    with pytest.raises(InputError, match="model: is 3; expected a Model"):
        rotorid.export(run[0], model=3, csv=tmp_path / "b.csv")


def test_what_is_no_run_is_refused_in_one_line(tmp_path: Path):
    with pytest.raises(InputError) as refused:
        rotorid.open_run(tmp_path)
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.filterwarnings("ignore::rotorid_torch.errors.OutsideRange")  # no fitted flight moves the pedals
def test_a_free_run_follows_a_flight_of_the_vehicle(run: tuple[Run, Path], data: Dataset):
    made, out = run
    flight = data["f_ped"]
    runs = [rotorid.simulate(model, flight, seconds=3.0, data=data) for model in (made, made.model, out)]
    for found in runs:
        assert found["time"][-1] == pytest.approx(3.0)
        assert np.allclose(found["r"], runs[0]["r"], rtol=0.0, atol=1e-9)
    error = runs[0]["r"] - flight["r"].numpy()[: len(runs[0]["r"])]
    assert np.sqrt(np.mean(error**2)) < 0.03  # noise of 0.02
    alone = rotorid.simulate(made, flight, seconds=3.0)  # noise of the one flight alone
    assert np.allclose(alone["r"], runs[0]["r"], atol=5e-3)


def test_the_command_says_where_a_free_run_leaves_the_range(
    run: tuple[Run, Path], data: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    words = ["--flight", "f_ped", "--seconds", "3", "--out", str(tmp_path / "f.npz")]
    assert main(["simulate", str(run[1]), str(written(data, tmp_path / "data")), *words]) == 0
    said = capsys.readouterr().out
    assert "do not trust it there" in said
    with np.load(tmp_path / "f.npz") as free:
        error = free["r"] - data["f_ped"]["r"].numpy()[: len(free["r"])]
    spread = np.var(data["f_ped"]["r"].numpy()[: len(error)])
    assert "│ time" not in said
    row = next(line for line in said.splitlines() if line.startswith("│ r "))
    assert f"{np.sqrt(np.mean(error**2)):.3g} rad/s" in row
    assert f"{1.0 - np.mean(error**2) / spread:.3f}" in row


def test_flights_are_drawn(data: Dataset):
    figure = data["f_lon"].plot(["q", "lon"])
    assert [axis.get_ylabel() for axis in figure.axes] == ["q, rad/s", "lon, rad"]
    assert set(data.plot(["q"])) == set(data.flights)
    with pytest.raises(InputError, match="did you mean 'q'"):
        data["f_lon"].plot(["qq"])
    x = np.random.default_rng(0).standard_normal((2, 200, 1)).cumsum(axis=1)
    spectrum = rotorid.regress(x[..., 0], x, 0.1, kind="value", noise="none").plot()
    assert spectrum.axes[0].get_xlabel() == "frequency, Hz"
    one = [[1.0]]
    filtered = rotorid.unscented_filter(lambda x, u: -x, lambda x, u: x, [0.0], one, one, one, x, x, 0.1)
    assert [[axis.get_ylabel() for axis in figure.axes] for figure in filtered.plot()] == [
        ["state 0", "innovation 0"]
    ] * 2
    for thing in (data, data["f_lon"], rotorid.check(data), filtered):
        assert thing._repr_html_().startswith("<p>")
    assert "<td>x[1,0]</td>" in filtered._repr_html_()


def test_flights_are_copied_for_other_processes_and_told_by_name(run: tuple[Run, Path], data: Dataset):
    on_demand = data.changed(lambda flight: flight)
    assert len(data.scales()) == len(pickle.loads(pickle.dumps(on_demand)).scales())
    for one in (pickle.loads(pickle.dumps(on_demand)), copy.deepcopy(data)):
        assert torch.equal(one["f_lon"]["q"], data["f_lon"]["q"])
    assert repr(pickle.loads(pickle.dumps(run[0]))) == repr(run[0])
    assert "f_lon" in data
    assert "f_long" not in data
    assert list(data["f_lon"]) == list(data["f_lon"].channels)
    assert "q" in data["f_lon"]
    assert "qq" not in data["f_lon"]


def test_windows_feed_a_loader(data: Dataset):
    from torch.utils.data import DataLoader

    windows = data.windows(seconds=2.0, every=0.5, outputs=["p", "q"])
    assert windows.flights == data.identify
    assert len(windows) == 3 * 15  # 9 s: windows begin at 0, 0.5 ... 7 s
    batch = next(iter(DataLoader(windows, batch_size=8, shuffle=True, generator=torch.Generator().manual_seed(0))))
    assert batch["controls"].shape == (8, 51, 4)
    assert batch["outputs"].shape == (8, 51, 2)
    for flight, start, outputs in zip(batch["flight"], batch["start"], batch["outputs"], strict=True):
        first = round(float(start) / DT)
        record = data[windows.flights[int(flight)]].stack(["p", "q"])
        assert torch.equal(outputs, record[first : first + 51])
    for wrong in ({"seconds": 20.0}, {"seconds": 0.0}, {"every": -1.0}, {"flights": ["f"]}, {"outputs": "q"}):
        with pytest.raises(InputError):
            data.windows(**wrong)  # pyright: ignore[reportArgumentType]


def test_a_flight_of_a_data_set_is_fitted_by_the_estimators(data: Dataset):
    record = data["f_lon"].arrays(controls=["lon"], outputs=["q"], x0=[0.0])
    assert torch.equal(record["time"], data["f_lon"].time)
    fitted = rotorid.output_error(Lag(), [record])
    assert [p.name for p in fitted.parameters] == ["a", "b"]
    with pytest.raises(InputError, match="did you mean 'lon'"):
        data["f_lon"].arrays(controls=["long"], outputs=["q"])


def test_tables_of_pandas(data: Dataset):
    pandas = pytest.importorskip("pandas", reason="pandas is not installed: tables are text")
    fitted = rotorid.output_error(Lag(), [response()], free=["a", "b"], x0="fixed")
    table = fitted.table()
    assert isinstance(table, pandas.DataFrame)
    assert table.set_index("name").loc["a", "value"] == fitted["a"].value
    assert table.set_index("name").loc["a", "se_white"] == fitted["a"].se_white
    x = np.random.default_rng(0).standard_normal((400, 2))
    found = rotorid.regress(x[:, 0], pandas.DataFrame(x, columns=["p", "lat"]), 0.02, kind="value", noise="none")
    assert found["p"].value == pytest.approx(1.0)
    assert found.table()["name"].tolist() == ["p", "lat"]
    frame = data["f_lon"].to_pandas()
    assert frame.index.name == "time"
    assert np.array_equal(frame["q"].to_numpy(), data["f_lon"]["q"].numpy())
    again = Dataset.from_arrays({"f": frame.reset_index()}, identify=["f"])
    assert torch.equal(again["f"]["q"], data["f_lon"]["q"])
    assert len(data.to_pandas()) == sum(flight.samples for flight in data)
    series = response() | {"controls": pandas.DataFrame({"u": np.ones(200)}), "time": pandas.Series(response()["time"])}
    assert rotorid.output_error(Lag(), [series], x0="fixed")["a"].value == pytest.approx(fitted["a"].value, abs=1e-9)


def test_without_pandas_it_is_said(data: Dataset, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="pandas is not installed"):
        data["f_lon"].to_pandas()
    assert isinstance(rotorid.output_error(Lag(), [response()], x0="fixed").table(), str)


def test_flights_and_channels_that_are_not_there_are_answered_with_those_that_are(data: Dataset):
    for missing in ("f_long", slice(1, 3), 0):
        with pytest.raises(KeyError, match="f_lon"):
            data[missing]  # pyright: ignore[reportArgumentType]
    for wrong in ("latt", ["q", "latt"], slice(0, 2), 0):
        with pytest.raises(KeyError, match="lat"):
            data["f_lon"][wrong]  # pyright: ignore[reportArgumentType]
    assert torch.equal(data["f_lon"][["q", "lon"]], data["f_lon"].stack(["q", "lon"]))
    assert [f.name for f in data] == list(data.flights)
    assert data["f_lon"].to_numpy()["q"].shape == (data["f_lon"].samples,)
