"""The commands from outside: help, one line for bad input, exit codes, and nothing half-written."""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest

import rotorid_torch
from rotorid_torch import cli
from rotorid_torch.core.storage import cache
from rotorid_torch.errors import InputError
from rotorid_torch.report import records

COMMANDS = ("fly", "check", "reconstruct", "identify", "close-loop", "simulate", "export", "effects", "show", "doctor")
PROGRAM = [sys.executable, "-m", "rotorid_torch"]


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    code = cli.main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return code, out, err


def a_run(folder: Path) -> Path:
    report = records.Report(
        command="identify",
        dataset=records.DatasetRecord(name="hover", sha256="00"),
        seed=0,
        time_s=records.TimeRecord(),
        peak_memory_mb=1.0,
        before=records.FitRecord(
            parameters=(), modes=(), flights={}, scores=records.ScoresRecord(identify=None, validate=None, acid=None)
        ),
    )
    folder.mkdir()
    (folder / "report.json").write_bytes(records.encode_report(report))
    return folder


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command_names_what_all_share(command: str, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as leaving:
        cli.main([command, "--help"])
    text = capsys.readouterr().out
    assert leaving.value.code == 0
    assert all(option in text for option in ("--quiet", "--json", "--seed", "--device"))


def test_what_a_command_has_loaded_is_looked_through_no_more_and_all_else_is():
    asked = "print(cli.main(['check', 'nowhere']), gc.isenabled(), gc.get_freeze_count())"
    asked = f"import gc; from rotorid_torch import cli; {asked}"
    said = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True).stdout.split()
    assert said[:2] == ["2", "True"]
    assert int(said[2]) > 100_000


def test_help_lists_exactly_the_commands_that_exist(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as leaving:
        cli.main(["--help"])
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines() if line.startswith("    ")]
    assert leaving.value.code == 0
    assert sorted(set(listed) & set(COMMANDS)) == sorted(COMMANDS)


def test_help_is_quick_because_it_imports_no_torch():
    code = "import sys, rotorid_torch.cli as c\ntry: c.main(['--help'])\nexcept SystemExit: pass\n"
    code += "assert not {'torch', 'matplotlib', 'rich', 'numpy'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)


BAD_USAGE = [
    ["fligh"],
    ["close-loop", "x"],
    ["identify"],
    ["identify", "x"],
    ["identify", "x", "--out"],
    ["identify", "x", "--out", "y", "--seed", "-1"],
    ["identify", "x", "--out", "y", "--seed", "1.5"],
    ["identify", "x", "--out", "y", "--seed", "99999999999999999999"],
    ["identify", "x", "--out", "y", "--device", "tpu"],
    ["identify", "x", "--out", "y", "--method", "guess"],
    ["identify", "x", "--out", "y", "--wrong"],
    ["fly", "--out", "y", "--size", "3"],
    ["fly", "--out", "y", "--effect", "a", "--size", "3", "--size", "4"],
    ["fly", "--out", "y", "--speed", "fast"],
    ["fly", "--out", "y", "--speed", "nan"],
    ["show"],
    ["show", "nowhere"],
    ["simulate", "m", "d", "--out", "f.npz"],
]


@pytest.mark.parametrize("arguments", BAD_USAGE, ids=" ".join)
def test_bad_usage_is_one_line_and_exit_2(arguments: list[str], capsys: pytest.CaptureFixture[str]):
    code, out, err = run(capsys, *arguments)
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert "expected" in err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["closeloop", "x"], "close-loop"),
        (["identify", "x", "--outt", "y"], "--out"),
        (["identify", "x", "--out", "y", "--method", "autp"], "auto"),
        (["fly", "--out", "y", "--effect", "control.dely"], "control.delay"),
        (["fly", "--out", "y", "--flights", "dbl_lonp"], "dbl_lon_p"),
        (["effects", "--jsn"], "--json"),
    ],
)
def test_what_is_misspelt_is_told_with_what_was_meant(
    arguments: list[str], hint: str, tmp_path: Path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    code, _, err = run(capsys, *arguments)
    assert (code, err.count("\n")) == (2, 1)
    assert f"did you mean '{hint}'?" in err


def test_a_misspelt_folder_is_told_with_what_lies_beside_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    a_run(tmp_path / "uh60-first")
    code, _, err = run(capsys, "show", tmp_path / "uh60-frst")
    assert code == 2
    assert f"did you mean '{tmp_path / 'uh60-first'}'?" in err


def test_without_a_command_help_with_examples_is_printed(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as leaving:
        cli.main([])
    text = capsys.readouterr().out
    assert leaving.value.code == 0
    assert sum(line.startswith("  rotorid ") for line in text.splitlines()) == 3


def test_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as leaving:
        cli.main(["--version"])
    assert leaving.value.code == 0
    assert capsys.readouterr().out == f"rotorid {rotorid_torch.__version__}\n"


def test_every_argument_of_every_command_is_described():
    (commands,) = (a.choices for a in cli.parser()._actions if isinstance(a.choices, dict))
    assert [(n, a.dest) for n, c in commands.items() for a in c._actions if not a.help] == []


def test_module_and_console_script_are_the_same_program(tmp_path: Path):
    result = subprocess.run([*PROGRAM, "show", str(tmp_path)], capture_output=True, text=True, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    assert f"{tmp_path}: holds no report.json" in result.stderr
    scripts = importlib.metadata.entry_points(group="console_scripts", name="rotorid")
    assert {script.value for script in scripts} <= {"rotorid_torch.cli:main"}


def options_of(*arguments: str) -> cli.Options:
    return cli.parser().parse_args(arguments)


def test_effects_of_fly_are_ordered_pairs_with_sizes():
    words = "--effect control.delay --size 0.05 --effect forces.drag --effect control.delay --size -0.1"
    options = options_of("fly", "--out", "d", *words.split())
    assert options.effect == [("control.delay", 0.05), ("forces.drag", None), ("control.delay", -0.1)]


def test_effects_of_identify_keep_their_order():
    assert options_of("identify", "d", "--out", "r", "--effect", "b", "--effect", "a").effect == ["b", "a"]
    assert options_of("identify", "d", "--out", "r").effect == []


def test_lists_of_flights_are_split_at_commas():
    assert options_of("fly", "--out", "d", "--flights", "f321_lon, dbl_lat_n").flights == ("f321_lon", "dbl_lat_n")


def test_show_as_json_is_one_object_with_the_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    one, two = a_run(tmp_path / "one"), a_run(tmp_path / "two")
    code, out, err = run(capsys, "show", one, two, "--json")
    assert (code, err) == (0, "")
    shown = json.loads(out)["runs"]
    assert list(shown) == [str(one), str(two)]
    assert shown[str(one)] == json.loads((one / "report.json").read_bytes())


def test_show_for_people_and_quiet(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = a_run(tmp_path / "one")
    code, out, err = run(capsys, "show", folder)
    assert (code, err) == (0, "")
    assert "hover" in out
    assert f"report: {folder / 'report.html'}\n" in out
    assert run(capsys, "show", folder, "--quiet") == (0, "", "")


def test_doctor_reports_versions(capsys: pytest.CaptureFixture[str]):
    code, out, _ = run(capsys, "doctor", "--json")
    found = json.loads(out)
    assert code == 0
    assert found["packages"]["torch"] == importlib.metadata.version("torch")
    project = tomllib.loads((Path(rotorid_torch.__file__).parents[1] / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    named = {n: {re.split("[>=]", one)[0] for one in extras[n]} for n in extras if n != "dev"}
    assert {name: {*packages} for name, packages in found["extras"].items()} == named
    code, out, _ = run(capsys, "doctor")
    assert code == 0
    assert "torchdiffeq" in out


def test_doctor_says_what_is_kept_and_empties_it(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("ROTORID_CACHE", str(tmp_path))
    cache.keep(f"{24 * 'a'}.so", bytes(2**20))
    size = (tmp_path / "native" / f"{24 * 'a'}.so").stat().st_size
    kept = {"folder": str(tmp_path / "native"), "files": 1, "bytes": size}
    found = json.loads(run(capsys, "doctor", "--json")[1])
    assert (found["cache"], found["removed"]) == (kept, None)
    assert "1 files, 1.0 MiB" in run(capsys, "doctor")[1]
    found = json.loads(run(capsys, "doctor", "--empty-cache", "--json")[1])
    assert (found["cache"], found["removed"]) == ({**kept, "files": 0, "bytes": 0}, kept)
    assert not (tmp_path / "native").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
@pytest.mark.parametrize("how", [[], ["--json"]])
def test_output_that_goes_nowhere_is_one_line(how: list[str]):
    with open("/dev/full", "w") as full:
        result = subprocess.run([*PROGRAM, "effects", *how], stdout=full, stderr=subprocess.PIPE, text=True)
    assert result.returncode == 2
    assert result.stderr.startswith("rotorid: standard output: cannot be written to (No space left on device)")
    assert result.stderr.count("\n") == 1


def test_a_file_that_the_system_refuses_is_one_line_with_its_name(monkeypatch, capsys):
    stub_show(monkeypatch, PermissionError(13, "Permission denied", "/somewhere/file"))
    code, out, err = run(capsys, "show", "x")
    assert (code, out) == (2, "")
    assert err.startswith("rotorid: /somewhere/file: cannot be used (Permission denied)")


def test_an_unexpected_error_without_room_for_its_log_is_one_line(monkeypatch, capsys, tmp_path: Path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
    stub_show(monkeypatch, ZeroDivisionError("x"))
    code, _, err = run(capsys, "show", "x")
    assert (code, err) == (1, "rotorid: unexpected ZeroDivisionError: x; the log is lost (No such file or directory)\n")


def stub_show(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    def fail(options: object) -> None:
        raise error

    monkeypatch.setattr(cli, "show", fail)


def test_unexpected_error_is_one_line_with_a_log_and_exit_1(monkeypatch, capsys, tmp_path: Path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    stub_show(monkeypatch, ZeroDivisionError("a\nb"))
    code, out, err = run(capsys, "show", "x")
    assert (code, out) == (1, "")
    assert err.startswith("rotorid: unexpected ZeroDivisionError: a b; the log is ")
    assert err.count("\n") == 1
    (log,) = tmp_path.glob("rotorid-*.log")
    assert "Traceback" in log.read_text()


@pytest.mark.parametrize(
    ("error", "expected"), [(KeyboardInterrupt(), 130), (InputError("a", "b", "c", "d"), 2), (MemoryError(), 1)]
)
def test_exit_codes(monkeypatch, capsys, tmp_path: Path, error: BaseException, expected: int):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    stub_show(monkeypatch, error)
    code, out, err = run(capsys, "show", "x")
    assert (code, out, err.count("\n")) == (expected, "", 1)


def test_torchs_compiler_leaves_no_folder(tmp_path: Path):
    program = "from rotorid_torch import cli; cli.main(['effects', '--quiet']); import torch._dynamo"
    given = {name: value for name, value in os.environ.items() if name != "TORCHINDUCTOR_CACHE_DIR"}
    subprocess.run([sys.executable, "-c", program], env={**given, "TMPDIR": str(tmp_path)}, check=True)
    assert not list(tmp_path.iterdir())


SLOW_COMMAND = """
import signal, sys, time
from rotorid_torch import cli
from rotorid_torch.run.output.folder import run_folder

signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background is born deaf to it

def work(options):
    with run_folder(options.runs[0], "identify") as folder:
        (folder / "report.json").write_text("half")
        print("working", flush=True)
        time.sleep(60)

cli.show = work
sys.exit(cli.main(["show", sys.argv[1]]))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_command_leaves_the_earlier_run_and_exits_130(tmp_path: Path, number: signal.Signals):
    earlier = a_run(tmp_path / "run")
    before = (earlier / "report.json").read_bytes()
    command = [sys.executable, "-c", SLOW_COMMAND, str(earlier)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "working\n"
    process.send_signal(number)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert err == "rotorid: interrupted\n"
    assert [p.name for p in tmp_path.iterdir()] == ["run"]
    assert (earlier / "report.json").read_bytes() == before


def test_a_reader_that_leaves_early_is_no_traceback(tmp_path: Path):
    folder = a_run(tmp_path / "run")
    read, write = os.pipe()
    os.close(read)
    command = [*PROGRAM, "show", str(folder), "--json"]
    result = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True)
    os.close(write)
    assert result.returncode == 1
    assert "Traceback" not in result.stderr


def test_run_in_the_way_is_refused_before_the_data_are_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.txt").touch()
    code, out, err = run(capsys, "identify", tmp_path / "no data", "--out", tmp_path / "run")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "not a run" in err
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["thesis.txt"]


def test_simulate_refuses_its_file_before_any_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for out, told in ((tmp_path, "is a folder"), (tmp_path / "no" / "f.npz", "does not exist")):
        words = ["simulate", tmp_path / "no model", tmp_path / "no data", "--flight", "f", "--out", out]
        code, _, err = run(capsys, *words)
        assert (code, err.count("\n")) == (2, 1)
        assert told in err


def test_missing_data_set_is_one_line_and_leaves_no_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for arguments in (["check"], ["reconstruct", "--out"], ["identify", "--out"]):
        out_option = [*arguments[1:], *([tmp_path / "run"] if len(arguments) > 1 else [])]
        code, out, err = run(capsys, arguments[0], tmp_path / "no data", *out_option)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert "no data" in err
    assert list(tmp_path.iterdir()) == []


def a_data_set(folder: Path) -> Path:
    generator = np.random.default_rng(0)
    (folder / "flights").mkdir(parents=True)
    for name in ("one", "two"):
        time = np.arange(600) / 50.0
        stick = np.where((time > 2) & (time < 4), 0.05, 0.0)
        channels = {"time": time, "lat": stick + 1e-4 * generator.standard_normal(600)}
        channels |= {name: 0.01 * generator.standard_normal(600).cumsum() / 10 for name in "qr"}
        channels["p"] = 0.05 * stick.cumsum() + 1e-4 * generator.standard_normal(600)
        np.savez(folder / "flights" / f"{name}.npz", **channels)  # pyright: ignore[reportArgumentType]
    head = 'format = 1\nname = "small"\nkind = "helicopter"\n[controls.lat]\nunit = "rad"\n'
    (folder / "dataset.toml").write_text(head + '[flights]\nidentify = ["one"]\nvalidate = ["two"]\n')
    return folder


def test_check_tells_findings_and_writes_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = a_data_set(tmp_path / "small")
    code, out, err = run(capsys, "check", folder, "--json", "--out", tmp_path / "run")
    assert (code, err) == (0, "")
    found = json.loads(out)
    assert found["dataset"] == "small"
    assert found["findings"]
    report = records.read_report(tmp_path / "run")
    assert report.command == "check"
    assert report.before is None
    assert (tmp_path / "run" / "report.html").stat().st_size > 1000
    assert "good: " in (tmp_path / "run" / "log.txt").read_text()
    code, out, err = run(capsys, "check", folder)
    assert (code, err) == (0, "")
    assert "small: " in out
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run", "small"]


def test_cuda_where_there_is_none_is_bad_input(monkeypatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    code, _, err = run(capsys, "doctor", "--device", "cuda")
    assert code == 2
    assert "--device" in err


def test_json_of_a_number_that_is_not_finite_is_null(capsys: pytest.CaptureFixture[str]):
    cli._answer(cli.Options(json=True, quiet=False), {"J": float("inf")}, "")
    assert msgspec.json.decode(capsys.readouterr().out) == {"J": None}


def test_a_profile_says_where_the_time_went(capsys: pytest.CaptureFixture[str]):
    assert cli.main(["effects", "--profile", "--quiet"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "seconds    calls  function"
    assert any(line.endswith("cli.effects") or "effects" in line for line in lines[1:])
