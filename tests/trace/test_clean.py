"""Floors come from clean aircraft that resemble the data; where too few do, from those that come nearest."""

from __future__ import annotations

import importlib
import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from rotorid_torch.core.atomic import Unwritable
from rotorid_torch.core.ranks import ALONE
from rotorid_torch.data.flight import Flight
from rotorid_torch.effects.registry import registered
from rotorid_torch.errors import InputError
from rotorid_torch.identification.gauss_newton import InfiniteCost
from rotorid_torch.trace import clean
from rotorid_torch.trace.floor import Floors, Null
from tests.known_models import body_spec, flown, linear_vehicle, manoeuvres, written

DRAWS = 24


@pytest.fixture(autouse=True)
def _place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ROTORID_CACHE", str(tmp_path))


def floors(monkeypatch: pytest.MonkeyPatch, alike: int, flew: int, asked: list[int] | None = None) -> Floors:
    """Of draws of which some resemble the data and some do not fly; `asked` gets the numbers that had to be flown."""

    def fly(*request: Any) -> dict[int, Any]:
        numbers: Sequence[int] = request[4]
        found = {}
        for n in numbers:
            gains = {"control.delay": 0.001 * n} if n < flew else {}
            others = {"traces": {"X": 0.1}, "forces": {"mass.slung_load": 0.01 * n}, "each_control": gains}
            others["evidence"] = {"control.delay": [0.001 * n, 0.0]}
            others["sizes"] = {"control.delay.common": 0.002 * n - 0.02}
            rest = others if gains else {}
            found[n] = {"gains": gains, "alike": n < alike, **rest, "misfit": 1.0 + n}
            clean._keep(request[5], n, found[n])
        if asked is not None:
            asked.extend(numbers)
        return found

    monkeypatch.setattr("rotorid_torch.fly.drawn.undrawable", lambda dataset: None)
    monkeypatch.setattr(clean, "_fly", fly)
    dataset = flown(linear_vehicle(), manoeuvres(4.0, 0.02), 0.02, noise=0.01)
    return clean.clean_floors(dataset, Null(body_spec(), {}), ["control.delay"], draws=DRAWS)


@pytest.mark.parametrize(
    ("alike", "flew", "counted", "said"),
    [
        (24, 24, 24, "floors come from 24 clean aircraft drawn in the likeness of this one"),
        (22, 24, 22, "floors come from 22 clean aircraft drawn in the likeness of this one"),
        (3, 23, 20, "only 3 of 24 drawn aircraft resemble the data: floors come from the 20 that come nearest"),
        (3, 19, 0, "floors come from shuffled residuals alone: 19 of 24 drawn aircraft could be flown"),
    ],
)
def test_of_which_aircraft_floors_are_made(
    monkeypatch: pytest.MonkeyPatch, alike: int, flew: int, counted: int, said: str
):
    found = floors(monkeypatch, alike, flew)
    assert found.note == said
    assert sorted(found.gains.get("control.delay", [])) == pytest.approx([0.001 * n for n in range(counted)])
    assert sorted(found.in_forces.get("mass.slung_load", [])) == pytest.approx([0.01 * n for n in range(counted)])
    assert sorted(found.sizes.get("control.delay.common", [])) == pytest.approx(
        [0.002 * n - 0.02 for n in range(counted)]
    )


def test_records_that_no_aircraft_can_follow_leave_no_word_of_it_to_the_next(monkeypatch: pytest.MonkeyPatch):
    assert not floors(monkeypatch, 0, 0).gains
    assert len(floors(monkeypatch, 24, 24).gains["control.delay"]) == DRAWS


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda content: b"",
    "cut": lambda content: content[: len(content) // 2],
    "no draw": lambda content: b"{}",
    "no JSON": lambda content: b"ten years of work",
    "edited": lambda content: content.replace(b"0.0", b"0.9"),
    "another type": lambda content: content.replace(b"0.003", b'"0.003"'),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_floors_are_drawn_anew_with_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: str
):
    first = floors(monkeypatch, 24, 24)
    (folder,) = (tmp_path / "native" / "floors").iterdir()
    for number in (3, 7):
        file = folder / f"{number}.json"
        file.write_bytes(DAMAGES[damage](file.read_bytes()) if number == 3 else b"")
    asked: list[int] = []
    again = floors(monkeypatch, 24, 24, asked)
    assert asked == [3, 7]
    assert caplog.messages == [f"{folder}: a kept file is cut short or changed; it is not used and made anew"]
    assert torch.equal(again.gains["control.delay"].sort().values, first.gains["control.delay"].sort().values)
    floors(monkeypatch, 24, 24, asked)
    assert asked == [3, 7]


def test_floors_without_a_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture):
    monkeypatch.setenv("ROTORID_CACHE", str(tmp_path / "file"))
    (tmp_path / "file").touch()
    assert len(floors(monkeypatch, 24, 24).gains["control.delay"]) == DRAWS
    (line,) = caplog.messages
    assert line.endswith("nothing can be kept there (Not a directory); it is made anew each time")


def test_processes_without_room_end_the_search_for_floors(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    worker = tmp_path / "worker"
    worker.write_text(f"#!/bin/sh\nexit {clean.NO_ROOM}\n")
    worker.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(worker))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    dataset = flown(linear_vehicle(), manoeuvres(4.0, 0.02), 0.02, noise=0.01)
    with pytest.raises(Unwritable, match=f"{tmp_path}: cannot be written to; expected room for temporary files"):
        clean._fly(dataset, Null(body_spec(), {}), ["control.delay"], 0, [0, 1], "floors/none", ALONE)
    assert [file.name for file in tmp_path.iterdir()] == ["worker"]


@pytest.mark.parametrize(
    "file", ["data/read.py", "validate/free_run.py", "trace/floor.py", "trace/decide.py", "trace/candidates.py"]
)
def test_no_other_version_of_the_package_reads_kept_floors(tmp_path: Path, file: str):
    package = shutil.copytree(Path(clean.__file__).parents[1], tmp_path / "p", ignore=shutil.ignore_patterns("*.pyc"))
    before = clean._code(package)
    assert clean._code(package) == before
    with (package / file).open("a") as handle:
        handle.write("# another version\n")
    assert clean._code(package) != before


def test_another_version_of_an_own_effect_reads_no_kept_floors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    file = tmp_path / "floors_of_my_effect.py"
    text = "from rotorid_torch.effects.base import Effect\n\n\nclass Mine(Effect):\n    id = 'my.effect'\n"
    file.write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    mine = importlib.import_module(file.stem).Mine
    before = clean._code()
    monkeypatch.setitem(registered(), "my.effect", mine)
    first = clean._code()
    file.write_text(f"{text}    ARM = 9.0\n")
    assert len({before, first, clean._code()}) == 3


Gains = Callable[[object, Null, Sequence[str]], dict[str, Any]]


def worked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, gains: Gains) -> dict[str, Any]:
    """What one process tells of three draws, of which the last does not fly."""
    drawn = [SimpleNamespace(number=n, dataset=None, alike=True, misfit=1.0, rotor="") for n in range(2)]
    monkeypatch.setattr("rotorid_torch.fly.drawn.clean_flights", lambda dataset, seed, numbers: iter(drawn))
    monkeypatch.setattr(clean, "gains_on", gains)
    data = written(flown(linear_vehicle(), manoeuvres(4.0, 0.02), 0.02, noise=0.01), tmp_path / "data")
    place = tmp_path / "floors"
    place.mkdir()
    plain = {"dataset": str(data), "spec": body_spec().plain(), "values": {}, "held": [], "effects": ["control.delay"]}
    clean._work({**plain, "seed": 0, "numbers": [0, 1, 2], "folder": str(place)})
    return {file.stem: json.loads(file.read_text()) for file in place.glob("*.json")}


def test_draws_of_a_process_lie_in_a_file_each(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    gains = {"control.delay": 0.1}
    told = worked(monkeypatch, tmp_path, lambda *_: {"gains": gains})
    assert {number: found["gains"] for number, found in told.items()} == {"0": gains, "1": gains, "2": {}}


def failing(error: Exception) -> Gains:
    def gains(*_: object) -> dict[str, Any]:
        raise error

    return gains


@pytest.mark.parametrize("error", [InfiniteCost(), torch.linalg.LinAlgError("no convergence")])
def test_an_aircraft_that_no_fit_begins_from_is_left_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: Exception
):
    assert worked(monkeypatch, tmp_path, failing(error)).keys() == {"2"}


@pytest.mark.parametrize("error", [InputError("f", "k", "w", "e"), RuntimeError("shape"), ValueError("1 of 2 values")])
def test_any_other_fault_is_not_passed_over(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: Exception):
    with pytest.raises(type(error)):
        worked(monkeypatch, tmp_path, failing(error))


def test_a_process_that_fails_is_reported_with_its_last_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    """No rotor is declared: nothing can be drawn, which is not asked again before."""
    data = flown(linear_vehicle(), manoeuvres(4.0, 0.02), 0.02, noise=0.01)
    with pytest.raises(RuntimeError, match="radius of the main rotor is not declared"):
        clean._fly(data, Null(body_spec(), {}), ["control.delay"], 0, [0], "floors/none", ALONE)
    assert capfd.readouterr().err == ""


def test_clean_aircraft_repeat_the_motion_through_the_air():
    """Head wind of 4 m/s at heading zero, tail wind after half a turn, about a trim at heading zero."""
    spec = body_spec(reference={**body_spec().reference, "psi": 0.0})
    told = {"environment.wind.north": -4.0, "environment.wind.east": 0.0}
    level = dict.fromkeys(("u", "v", "w", "p", "q", "r", "phi", "theta"), torch.zeros(2, dtype=torch.float64))
    flight = Flight(
        "f", 1.0, {"time": torch.arange(2.0), **level, "psi": torch.tensor([0.0, torch.pi], dtype=torch.float64)}
    )
    found = clean._through_air(flight, Null(spec, told))
    torch.testing.assert_close(found["u"], torch.tensor([0.0, -8.0], dtype=torch.float64))
    torch.testing.assert_close(found["v"], torch.zeros(2, dtype=torch.float64), atol=1e-12, rtol=0.0)
    assert clean._through_air(flight, Null(spec, {})) == {}


def test_a_file_in_the_working_folder_takes_no_part_in_a_worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "random.py").write_text("raise RuntimeError('shadowed')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    request = tmp_path / "request.json"
    request.write_text("{}")
    with clean._worker(request) as worker:
        worker.wait()
    assert request.with_suffix(".log").read_text().endswith("KeyError: 'dataset'\n")
