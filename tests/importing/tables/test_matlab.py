"""MATLAB files as other programs save them: units and names beside the numbers, several flights, fdata in a struct."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rotorid_torch as rotorid
from rotorid_torch.errors import InputError
from tests.importing.tables.test_columns import KNOWN, TIME, channels, near

OWN = {"lat": KNOWN["motor1"] - 0.5, "p": KNOWN["p"], "q": KNOWN["q"], "phi": KNOWN["phi"]}
DEGREES = {name: values if name == "lat" else np.degrees(values) for name, values in OWN.items()}
NAMES, UNITS = np.array([*OWN], object), np.array(["rad", "deg/s", "deg/s", "deg"], object)
MATRIX = np.stack([TIME, *OWN.values()], -1)


def saved(tmp_path: Path, content: dict[str, object]) -> Path:
    import scipy.io

    scipy.io.savemat(tmp_path / "s.mat", content)
    return tmp_path / "s.mat"


FORMS = {
    "units of members": {
        "tt": {"Time": TIME, **DEGREES, "Properties": {"VariableNames": NAMES, "VariableUnits": UNITS}}
    },
    "units of a matrix": {
        "tt": {
            "Time": TIME,
            "Variables": np.stack([*DEGREES.values()], -1),
            "VariableNames": NAMES,
            "VariableUnits": UNITS,
        }
    },
    "units of series": {
        "log": {
            name: {"Time": TIME, "Data": values, "DataInfo": {"Units": unit}}
            for (name, values), unit in zip(DEGREES.items(), UNITS, strict=True)
        }
    },
    "times of rows": {"tt": {**OWN, "Properties": {"VariableNames": NAMES, "RowTimes": TIME}}},
    "times beside a matrix": {
        "tt": {
            "RowTimes": TIME[:, None],
            "Variables": np.stack([*OWN.values()], -1),
            "Properties": {"VariableNames": NAMES[None]},
        }
    },
    "importdata": {"d": {"data": MATRIX, "colheaders": np.array(["time", *OWN], object)}},
    "names beside a matrix": {"data": MATRIX, "names": np.array(["time", *OWN], object)},
    "names beside a matrix with a channel in each row": {"data": MATRIX.T, "labels": np.array(["time", *OWN], object)},
    "names in rows of characters": {"data": MATRIX, "names": np.array([f"{n:<6}" for n in ["time", *OWN]])},
    "units of people": {
        "data": np.stack([TIME, *DEGREES.values()], -1),
        "names": np.array(["time", *OWN], object),
        "units": np.array(["s", *UNITS], object),
    },
    "units of members in their order": {"d": {"time": TIME, **DEGREES, "units": np.array(["s", *UNITS], object)}},
    "units by name": {"d": {"time": TIME, **DEGREES, "units": dict(zip(OWN, UNITS, strict=True))}},
    "signals without a label": {
        name: {"time": TIME[:, None], "signals": {"values": values[:, None], "dimensions": 1.0, "label": ""}}
        for name, values in OWN.items()
    },
}


@pytest.mark.parametrize("form", FORMS)
def test_structs_say_names_times_and_units(form: str, tmp_path: Path):
    file = saved(tmp_path, FORMS[form])
    assert near(channels(file, tmp_path), 1e-6)
    assert rotorid.import_log(file, tmp_path / "again").warnings == ()


@pytest.mark.parametrize("series", [False, True])
def test_structs_with_the_same_controls_are_flights(series: bool, tmp_path: Path):
    def flight(sign: float) -> dict[str, object]:
        columns = {name: sign * values for name, values in OWN.items()}
        return {n: {"Time": TIME, "Data": v} for n, v in columns.items()} if series else {"time": TIME, **columns}

    done = rotorid.import_log(saved(tmp_path, {"first": flight(1.0), "second": flight(-1.0)}), tmp_path / "set")
    flights = rotorid.load(done.folder).flights
    assert len(flights) == 2
    for flight_, sign in zip(flights.values(), (1.0, -1.0), strict=True):
        assert np.abs(flight_.channels["p"].numpy() - sign * OWN["p"])[2:-2].max() < 1e-4
    assert any("first, second have the same controls" in told for told in done.warnings)


def test_an_array_of_structs_has_a_flight_in_each(tmp_path: Path):
    runs = np.zeros((1, 2), [("time", object), *((name, object) for name in OWN)])
    for number, sign in enumerate((1.0, -1.0)):
        runs[0, number] = (TIME, *(sign * values for values in OWN.values()))
    flights = rotorid.load(rotorid.import_log(saved(tmp_path, {"run": runs}), tmp_path / "set").folder).flights
    for flight_, sign in zip(flights.values(), (1.0, -1.0), strict=True):
        assert np.abs(flight_.channels["p"].numpy() - sign * OWN["p"])[2:-2].max() < 1e-4


def test_structs_with_other_channels_are_one_flight(tmp_path: Path):
    parts = {"sticks": {"time": TIME, "lat": OWN["lat"]}, "imu": {"time": TIME, "p": OWN["p"], "q": OWN["q"]}}
    done = rotorid.import_log(saved(tmp_path, parts | {"ekf": {"time": TIME, "phi": OWN["phi"]}}), tmp_path / "set")
    assert len(done.flights) == 1
    assert {"lat", "p", "q", "phi"} <= done.channels.keys()


def test_fdata_in_a_struct(tmp_path: Path):
    fdata = np.zeros((len(TIME), 90))
    fdata[:, 0], fdata[:, 4], fdata[:, 13] = TIME, np.degrees(OWN["p"]), np.degrees(OWN["lat"])
    found = channels(saved(tmp_path, {"fds": {"fdata": fdata, "t": TIME}}), tmp_path)
    assert np.abs(found["p"] - OWN["p"]).max() < 1e-6
    assert np.abs(found["lon"] - OWN["lat"]).max() < 1e-6


def test_a_file_without_a_known_control_says_what_it_has(tmp_path: Path):
    file = saved(tmp_path, {"run": {"time": TIME, "sticks": MATRIX[:, 1:3]}})
    with pytest.raises(InputError, match=r"it has run.time, run.sticks\[0\], run.sticks\[1\]"):
        rotorid.import_log(file, tmp_path / "set")


def stored(file: Path, columns: dict[str, np.ndarray]) -> Path:
    """The columns as .npz or .parquet; several numbers a sample are a list of that."""
    if file.suffix == ".npz":
        np.savez(file, **columns)
        return file
    parquet, arrow = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow")
    parquet.write_table(arrow.table({n: v if v.ndim == 1 else v.tolist() for n, v in columns.items()}), file)
    return file


@pytest.mark.parametrize("ending", ["npz", "parquet"])
def test_durations_are_a_clock(ending: str, tmp_path: Path):
    durations = np.round(1e9 * TIME).astype("timedelta64[ns]")
    assert near(channels(stored(tmp_path / f"s.{ending}", {"time": durations, **OWN}), tmp_path), 1e-6)


@pytest.mark.parametrize("ending", ["npz", "parquet"])
def test_what_is_no_column_of_numbers_is_told_and_refused_as_a_channel(ending: str, tmp_path: Path):
    words = np.array(["hover"] * len(TIME))
    file = stored(tmp_path / f"s.{ending}", {"time": TIME, **OWN, "mode": words})
    assert rotorid.import_log(file, tmp_path / "set").warnings == (
        f"s.{ending}: left out, for it is no column of numbers: mode",
    )
    with pytest.raises(InputError, match=r"theta: is of type .*; expected numbers, one a sample"):
        rotorid.import_log(stored(file, {"time": TIME, **OWN, "theta": words}), tmp_path / "set")


def test_lists_of_numbers_in_parquet_are_told(tmp_path: Path):
    file = stored(tmp_path / "s.parquet", {"time": TIME, **OWN, "gyro": MATRIX})
    assert "no column of numbers: gyro" in " ".join(rotorid.import_log(file, tmp_path / "set").warnings)
