"""Typical mistakes at the command line: exit code 2 and one line that says what is wrong and what to do instead."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from rotorid_torch import cli
from tests.helpers import small_flight
from tests.mistakes import RAW

DECLARED = """\
format = 1
name = "small"
kind = "helicopter"
[controls.lat]
unit = "rad"
[flights]
identify = ["f"]
"""
FLIGHT = small_flight()
ROWS = np.stack([FLIGHT[name] for name in ("time", "lat", "p", "q", "r")], axis=1)


def data_set(folder: Path, change: Callable[[str], str] = str, **channels: object) -> Path:
    """A data set with a changed declaration, or changed channels."""
    (folder / "flights").mkdir(parents=True)
    (folder / "dataset.toml").write_text(change(DECLARED), encoding="utf-8")
    np.savez(folder / "flights" / "f.npz", **(FLIGHT | channels))  # pyright: ignore[reportArgumentType]
    return folder


def table(file: Path, names: str = "time,lat,p,q,r", rows: Iterable[Iterable[object]] = ROWS) -> Path:
    lines = [names, *(",".join(map(str, row)) for row in rows)]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


def refused(capsys: pytest.CaptureFixture[str], line: str, *says: str) -> None:
    """A command is refused in one line that holds these words."""
    assert cli.main(line.split()) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert said.startswith("rotorid")
    assert "; expected " in said
    assert not any(word in said for word in RAW)
    for words in says:
        assert words in said


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


DECLARATIONS = {
    "no format": (("format = 1\n", ""), "format: is missing"),
    "another format": (("format = 1", "format = 2"), "format: is 2"),
    "no TOML": (("format = 1", "format = = 1"), "is not TOML"),
    "another kind": (("helicopter", "airplane"), "kind: is 'airplane'"),
    "degrees": (('"rad"', '"deg"'), "controls.lat.unit: is 'deg'"),
    "a flight without a file": (('["f"]', '["g"]'), "flights/g.npz: there is no such file"),
    "no flight": (('["f"]', "[]"), "flights.identify: is empty"),
    "a word for a list": (('["f"]', '"f"'), "flights.identify: is 'f'"),
    "a flight in two lists": (('["f"]', '["f"]\nvalidate = ["f"]'), "is also in flights.identify"),
    "a control that no flight has": (("controls.lat", "controls.col"), "col: is missing"),
    "limits turned round": (('"rad"', '"rad"\nlimits = [0.2, -0.2]'), "controls.lat.limits: is [0.2, -0.2]"),
    "a mass with its unit": (("[flights]", '[vehicle]\nmass = "7257 kg"\n[flights]'), "vehicle.mass: is '7257 kg'"),
    "a mass below zero": (("[flights]", "[vehicle]\nmass = -3\n[flights]"), "vehicle.mass: is -3"),
    "a misspelt key": (("[flights]", "[vehicle]\nmas = 3.0\n[flights]"), "did you mean 'mass'?"),
    "three moments of inertia": (("[flights]", "[vehicle]\ninertia = [1, 2, 3]\n[flights]"), "inertia[0]: is 1"),
    "half a blade": (("[flights]", "[vehicle.rotor]\nblades = 4.5\n[flights]"), "blades: is 4.5"),
    "a rotor that turns left": (("[flights]", '[vehicle.rotor]\ndirection = "left"\n[flights]'), "'ccw' or 'cw'"),
    "a hub of two numbers": (("[flights]", "[vehicle]\nhub = [0, 1]\n[flights]"), "hub: is [0, 1]"),
}


@pytest.mark.parametrize("kind", DECLARATIONS)
def test_declarations(kind: str, place: Path, capsys: pytest.CaptureFixture[str]):
    (old, new), says = DECLARATIONS[kind]
    data_set(place / "set", lambda text: text.replace(old, new))
    refused(capsys, "check set", says)


CHANNELS = {
    "milliseconds": ({"time": 1000.0 * FLIGHT["time"]}, "time: has samples"),
    "words": ({"p": FLIGHT["p"].astype(str)}, "p: is text"),
    "a column for a record": ({"p": FLIGHT["p"][:, None]}, "p: has 2 dimensions"),
    "a record too short": ({"p": FLIGHT["p"][:-1]}, "p: "),
    "objects": ({"p": FLIGHT["p"].astype(object)}, "p: is a pickled object"),
}


@pytest.mark.parametrize("kind", CHANNELS)
def test_channels(kind: str, place: Path, capsys: pytest.CaptureFixture[str]):
    channels, says = CHANNELS[kind]
    data_set(place / "set", **channels)
    refused(capsys, "check set", says)


def test_rates_without_a_sample_are_not_usable(place: Path, capsys: pytest.CaptureFixture[str]):
    missing = np.full(len(FLIGHT["p"]), np.nan)
    data_set(place / "set", **dict.fromkeys(FLIGHT.keys() - {"time", "lat", "lon"}, missing))
    assert cli.main(["check", "set"]) == 3
    assert "not usable, because" in capsys.readouterr().out


def test_places_that_are_no_data_set(place: Path, capsys: pytest.CaptureFixture[str]):
    data_set(place / "flown")
    (place / "run").mkdir()
    (place / "run" / "report.json").write_text("{}", encoding="utf-8")
    refused(capsys, "check flwn", "there is no such folder (did you mean 'flown'?)")
    refused(capsys, "check run", "run: is a run, not a data set")
    refused(capsys, "check flown/flights", "holds no dataset.toml", "as 'flown' is")
    refused(capsys, "check flown/flights/f.npz", "is not a folder", "as 'flown' is")
    refused(capsys, "identify flown --out flown", "is in the way and is not a run")
    refused(capsys, "check flown --output run", "rotorid check: there is no option --output (did you mean '--out'?)")
    refused(capsys, "identify flown --out new --effect delay", "'control.delay' or 'sensors.delay'")


def test_a_single_flight_judges_no_effect(place: Path, capsys: pytest.CaptureFixture[str]):
    data_set(place / "set")
    refused(capsys, "close-loop set --out run", "f.npz: flights: there is one flight", "fly another, or cut a long one")


def test_places_that_are_no_run(place: Path, capsys: pytest.CaptureFixture[str]):
    data_set(place / "flown")
    (place / "runs" / "first").mkdir(parents=True)
    report = place / "runs" / "first" / "report.json"
    report.write_text("{", encoding="utf-8")
    for command in ("show {} --text", "export {} --csv new.csv"):
        refused(capsys, command.format("nothing"), "there is no such folder")
        refused(capsys, command.format("flown"), "flown: is a data set, not a run")
        refused(capsys, command.format("runs"), "runs: holds no report.json; inside are first")
        refused(capsys, command.format("runs/first/report.json"), "is a file", "as 'runs/first' is")
        refused(capsys, command.format("runs/first"), "is not JSON")


FILES = {
    "a raw blackbox": ("log.bbl", "blackbox_decode"),
    "a spreadsheet": ("log.xlsx", "saved as .csv"),
    "telemetry": ("log.tlog", ".bin of ArduPilot"),
    "a bag": ("log.bag", "its topics as .csv"),
    "a packed log": ("log.zip", "packed"),
    "no log at all": ("log.jpg", "expected one of .ulg"),
    "text that is no ULog": ("log.ulg", "is not a ULog"),
    "text that is no DataFlash": ("log.bin", "is not a DataFlash log"),
}


@pytest.mark.parametrize("kind", FILES)
def test_logs_of_other_programs(kind: str, place: Path, capsys: pytest.CaptureFixture[str]):
    name, says = FILES[kind]
    (place / name).write_bytes(b"PK nothing that any reader takes")
    refused(capsys, f"import {name} --out new", name, says)


TABLES = {
    "no rows": (lambda file: table(file, rows=[]), "holds no sample"),
    "one row": (lambda file: table(file, rows=ROWS[:1]), "holds one sample"),
    "nothing at all": (lambda file: file.write_text(""), "is empty"),
    "a name twice": (
        lambda file: table(file, names="time,lat,p,p,r"),
        "p: is twice in the header",
    ),
    "no clock": (lambda file: table(file, names="a,lat,p,q,r"), "time: is missing"),
    "no control": (lambda file: table(file, names="time,a,p,q,r"), "has no control"),
    "a clock that stands": (lambda file: table(file, rows=np.c_[0.0 * ROWS[:, :1], ROWS[:, 1:]]), "stands still"),
    "two clocks": (lambda file: table(file, rows=ROWS + 100.0 * (np.arange(len(ROWS))[:, None] // 5 % 2)), "runs back"),
    "words": (lambda file: table(file, rows=[[0.0, 0, 0, 0, 0], [0.1, "up", 0, 0, 0]]), "is 'up' in line 3"),
    "a short row": (lambda file: table(file, rows=[*ROWS[:5], ROWS[5, :3], *ROWS[6:]]), "another number of fields"),
}


@pytest.mark.parametrize("kind", TABLES)
def test_tables(kind: str, place: Path, capsys: pytest.CaptureFixture[str]):
    write, says = TABLES[kind]
    write(place / "log.csv")
    refused(capsys, "import log.csv --out new", "log.csv", says)


def test_usage_of_import(place: Path, capsys: pytest.CaptureFixture[str]):
    table(place / "log.csv")
    data_set(place / "flown")
    (place / "map.toml").write_text('[channels]\nroll = { column = "p" }\n', encoding="utf-8")
    refused(capsys, "import log.csv", "rotorid import: the following arguments are required: --out")
    refused(capsys, "import log.csv --out new --rate 0", "--rate: 0.0: is out of range")
    refused(capsys, "import log.csv --out new --rate fast", "'fast' is not a finite number")
    refused(capsys, "import log.csv --out new --map no.toml", "no.toml: there is no such file")
    refused(capsys, "import log.csv --out new --map map.toml", "channels.roll.column: unknown key")
    refused(capsys, "import log.cvs --out new", "did you mean 'log.csv'?")
    refused(capsys, "import flown --out new", "flown: is a folder")
    refused(capsys, "import log.csv --out flown", "is in the way")
    refused(capsys, "import log.csv --out log.csv", "is in the way and is not a folder")
