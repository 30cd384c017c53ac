"""Hostile files and names at every place where a command reads: exit code 2 and one line that names the place."""

from __future__ import annotations

import codecs
import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from rotorid_torch import cli
from rotorid_torch.model.nominal import build
from rotorid_torch.model.save import save
from tests.core.storage.test_files import KINDS, _no_hanging, special
from tests.helpers import ROOT, small_flight, small_folder, small_toml
from tests.known_models import body_spec, scattered
from tests.test_cli import a_run

__all__ = ["_no_hanging"]

LOGS = ("ulg", "bin", "csv", "npz", "mat", "parquet")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a data set, a run with a model, and a table to import; the working directory."""
    monkeypatch.chdir(tmp_path)
    small_folder(tmp_path / "set")
    a_run(tmp_path / "run")
    spec = body_spec()
    save(scattered(build(spec)), spec, tmp_path / "run" / "model.pt")
    np.savez(tmp_path / "f.npz", **small_flight())
    (tmp_path / "map.toml").write_text('[channels]\nlat = "lat"\np = "p"\n')
    return tmp_path


SIMULATE = "simulate run set --flight one --out free.npz"
READ = {
    "set/dataset.toml": "check set",
    "set/flights/one.npz": "check set",
    "set/flights/two.csv": "identify set --out new",
    "run/report.json": "show run",
    "run/model.pt": SIMULATE,
    "map.toml": "import f.npz --out new --map map.toml",
    "vehicle.toml": "fly --out new --vehicle vehicle.toml",
    **{f"log.{kind}": f"import log.{kind} --out new" for kind in LOGS},
}
"""Files that are read, and a command that reads each."""


def refused(command: str, capsys: pytest.CaptureFixture[str]) -> str:
    """Its line on stderr: exit code 2, nothing else said, nothing left behind."""
    before = sorted(Path().rglob("*"))
    assert cli.main(command.split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(r"rotorid: [^\n]+; expected [^\n]+\n", err), err
    assert sorted(Path().rglob("*")) == before
    return err


@pytest.mark.parametrize("file", READ)
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_regular_file(place: Path, kind: str, file: str, capsys: pytest.CaptureFixture[str]):
    (place / file).unlink(missing_ok=True)
    if file.endswith("two.csv"):
        (place / "set" / "flights" / "two.npz").unlink()
    word = special(kind, place / file) if kind != "socket" else "cannot be read"
    if kind == "socket":
        os.chdir((place / file).parent)
        special(kind, Path(Path(file).name))
        os.chdir(place)
    line = refused(READ[file], capsys)
    assert Path(file).name in line
    assert word in line


@pytest.mark.skipif(os.geteuid() != 0, reason="only the superuser can become somebody else")
@pytest.mark.parametrize("file", ["set", "set/flights", "set/dataset.toml", "run", "run/model.pt", "f.npz", "map.toml"])
def test_what_may_not_be_read(place: Path, file: str, capsys: pytest.CaptureFixture[str]):
    command = {"set": "check set", "run": "show run", "run/model.pt": SIMULATE, "f.npz": "import f.npz --out new"}
    for folder in (place, *list(place.parents)[:3]):  # tests in several processes have a folder more
        folder.chmod(0o777)
    (place / file).chmod(0)
    codecs.lookup("cp437")  # of names in npz files; Python itself may lie where nobody else can read
    os.seteuid(65534)
    try:
        line = refused(command.get(file) or READ.get(file, "check set"), capsys)
    finally:
        os.seteuid(0)
    assert file.partition("/")[0] in line
    assert "ermission" in line


def spec_of(place: Path) -> dict:
    return torch.load(place / "run" / "model.pt", weights_only=True)


IMPOSSIBLE = {
    "gravity": float("nan"),
    "mass": float("nan"),
    "air_density": -1.0,
    "inertia": [[1.0, 0.0, 0.0], [0.0, float("inf"), 0.0], [0.0, 0.0, 1.0]],
    "hub": [float("nan"), 0.0, 0.0],
    "imu": [1e9, 0.0, 0.0],
    "reference": {"u": float("nan")},
    "sizes": {"p": -1.0},
    "ranges": {"p": [2.0, 1.0]},
    "values": {"L.p": float("inf")},
    "states": ["u", "u"],
    "controls": ["lon", "lon"],
    "rotor": {"blades": 4, "radius": -8.0, "chord": 0.5, "speed": 27.0},
    "motors": [{"position": [0.1, 0.0, 0.0], "spin": 3.0}],
}


@pytest.mark.parametrize("key", IMPOSSIBLE)
def test_models_of_no_vehicle(place: Path, key: str, capsys: pytest.CaptureFixture[str]):
    held = spec_of(place)
    value = IMPOSSIBLE[key]
    old = held["spec"].get(key)
    held["spec"][key] = {**old, **value} if isinstance(value, dict) and isinstance(old, dict) else value
    torch.save(held, place / "run" / "model.pt")
    line = refused(SIMULATE, capsys)
    assert f"model.pt: spec.{key}" in line


def test_models_that_do_not_fit_together(place: Path, capsys: pytest.CaptureFixture[str]):
    held = spec_of(place)
    state = held["state"]
    theta = state["theta"]
    for change, told in (
        ({"theta": theta[:-1]}, "state: theta: has the shape"),
        ({"theta": theta.float()}, "no tensor of float64"),
        ({"theta": theta * torch.nan}, "not finite"),
        ({"theta": torch.zeros(1, dtype=torch.float64).expand(10**12)}, "has the shape"),
        ({"theta": theta.to_sparse()}, "no tensor"),
        ({"theta": [0.0]}, "no tensor"),
        ({"imu": state["imu"] + 1.0}, "state: imu: is not what follows from the spec"),
        ({"other": theta}, "state: does not belong to the spec (other)"),
    ):
        torch.save({**held, "state": {**state, **change}}, place / "run" / "model.pt")
        assert told in refused(SIMULATE, capsys)


def test_torch_is_not_heard(place: Path, capsys: pytest.CaptureFixture[str]):
    """Its words advise to load with weights_only=False, which runs what the file says."""
    file = place / "run" / "model.pt"
    torch.save({"format": 1, "spec": Path("x"), "state": {}}, file)
    foreign = file.read_bytes()
    whole = b"PK" + bytes(100)
    for content in (foreign, whole, b"", b"\x80\x02}q\x00.", foreign[:-30]):
        file.write_bytes(content)
        line = refused(SIMULATE, capsys)
        assert "is not a model" in line
        assert not re.search(r"weights_only|pickle|torch\.load|[Uu]npickl", line)


def test_models_that_unpack_to_too_much(place: Path, capsys: pytest.CaptureFixture[str]):
    file = place / "run" / "model.pt"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("model/data.pkl", bytes(200_000_000))
    assert file.stat().st_size < 1_000_000
    assert "unpacks to 200000000 bytes" in refused(SIMULATE, capsys)


REPORTS = {
    "seed": (-1, "seed: is -1"),
    "time_s": ({"total": -3.0}, "time_s.total: is -3.0"),
    "peak_memory_mb": ("much", "peak_memory_mb: is 'much'"),
    "dataset": (None, "dataset: is None"),
    "format": (2, "format: is 2"),
    "before.scores": ({"identify": -0.1, "validate": None, "acid": None}, "before.scores.identify: is -0.1"),
    "before.parameters": (
        [{"name": "L.p", "value": 0.0, "se": 0.1, "unit": "1/s", "bounds": [1.0, -1.0]}],
        "before.parameters[0].bounds: is 1 to -1",
    ),
}


@pytest.mark.parametrize("key", REPORTS)
def test_reports_of_no_run(place: Path, key: str, capsys: pytest.CaptureFixture[str]):
    file = place / "run" / "report.json"
    document = json.loads(file.read_text())
    value, told = REPORTS[key]
    *outer, last = key.split(".")
    part = document
    for name in outer:
        part = part[name]
    part[last] = value
    file.write_text(json.dumps(document))
    assert told in refused("show run", capsys)


@pytest.mark.parametrize("content", ["", "[" * 100_000, '{"seed": NaN}', '"\\ud800"', "\xff", "{}", "[]", "null"])
def test_what_is_no_report(place: Path, content: str, capsys: pytest.CaptureFixture[str]):
    (place / "run" / "report.json").write_text(content, encoding="latin-1")
    refused("show run", capsys)
    refused("check set --out run", capsys)  # nor is the folder a run that may be replaced


STEERING = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202e[bold red]"


def quiet(text: str) -> None:
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]", text), ascii(text)


def test_names_of_a_data_set_are_shown_and_not_obeyed(place: Path, capsys: pytest.CaptureFixture[str]):
    name = json.dumps(STEERING)  # TOML's escapes are JSON's, but for the delete character
    arrays = small_flight()
    np.savez(place / "set" / "flights" / f"o{STEERING[:0]}ne.npz", **arrays, **{STEERING: arrays["p"]})
    text = small_toml().replace('name = "small"', f"name = {name}")
    (place / "set" / "dataset.toml").write_text(text + f"{name} = 3\n", encoding="utf-8")
    for command in ("check set --out checked", "check set --json"):
        assert cli.main(command.split()) in (0, 3)
        out, err = capsys.readouterr()
        quiet(out + err)
        assert "owned" in out
    quiet((place / "checked" / "report.html").read_text())
    quiet((place / "checked" / "log.txt").read_text())
    assert cli.main(["show", "checked"]) == 0
    quiet(capsys.readouterr().out)
    (place / "set" / "dataset.toml").write_text(text.replace("[vehicle]", f"[vehicle]\n{name} = 1"), encoding="utf-8")
    quiet(refused("check set", capsys))


def test_names_of_files_are_shown_and_not_obeyed(place: Path, capsys: pytest.CaptureFixture[str]):
    bad = f"a{STEERING.replace('/', '')}\udcff.npz"
    os.rename("f.npz", bad)
    for more in ([], ["--json"]):
        assert cli.main(["import", bad, "--out", f"new{bad}", *more]) == 0
        out, err = capsys.readouterr()
        quiet(out + err)
    for more, code in (([], 0), (["--json"], 0), (["--out", "checked"], 0), (["--out", f"run{bad}"], 2)):
        assert cli.main(["check", f"new{bad}", *more]) in (code, 3)
        quiet("".join(capsys.readouterr()))
    for command in (["show", bad], ["check", bad], ["import", bad, "--out", "f", "--map", bad], ["fly", "--out", bad]):
        assert cli.main(command) == 2
        out, err = capsys.readouterr()
        assert err.count("\n") == 1
        quiet(out + err)


def test_names_of_a_report_are_shown_and_not_obeyed(place: Path, capsys: pytest.CaptureFixture[str]):
    file = place / "run" / "report.json"
    document = json.loads(file.read_text())
    document["dataset"]["name"] = STEERING
    document["warnings"] = [STEERING]
    document["verdict"] = {"kind": "unknown", "effects": [STEERING], "sentence": STEERING}
    file.write_text(json.dumps(document))
    for more in ([], ["--json"]):
        assert cli.main(["show", "run", *more]) == 0
        out = capsys.readouterr().out
        quiet(out)
        assert "[bold red]" in out  # no markup either


def test_json_says_names_exactly(place: Path, capsys: pytest.CaptureFixture[str]):
    file = place / "run" / "report.json"
    document = json.loads(file.read_text())
    document["dataset"]["name"] = STEERING
    file.write_text(json.dumps(document))
    assert cli.main(["show", "run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["runs"]["run"]["dataset"]["name"] == STEERING


def test_signs_that_an_output_cannot_write(place: Path):
    """A terminal of another encoding than UTF-8 gets other signs, not an error."""
    code = "from rotorid_torch import cli\nfor words in ('effects', 'check set', 'check nö'):\n"
    code += "    assert cli.main(words.split()) in (0, 2, 3), words\n"
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONPATH": str(ROOT)}
    ended = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert b"unexpected" not in ended.stderr
