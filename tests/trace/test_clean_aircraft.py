"""Critical values come from clean aircraft in the likeness of the data: drawn until the answer is clear, and cached."""

from __future__ import annotations

import importlib
import json
import shutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from rotorid_torch.core.gauss_newton import InfiniteCost
from rotorid_torch.core.processes.pool import NO_ROOM, worker
from rotorid_torch.core.storage import cache
from rotorid_torch.core.storage.atomic import Unwritable
from rotorid_torch.data import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.effects.registry import registered
from rotorid_torch.errors import InputError
from rotorid_torch.trace import clean_aircraft
from rotorid_torch.trace.clean_aircraft import SPARE, Request, Task
from rotorid_torch.trace.evidence.critical_values import Draws, Null
from rotorid_torch.trace.terms.settings import SETTINGS
from tests.helpers import small_arrays
from tests.known_models import body_spec, flown, linear_vehicle, manoeuvres, written

WANTED = SETTINGS.draws
NUMBERS = WANTED + SPARE
LOUD, QUIET = 1e3, 0.0


@dataclass(frozen=True)
class Observed:
    """Statistics of the data's family."""

    contest: Mapping[str, float]
    least: Mapping[str, float]


@pytest.fixture(autouse=True)
def _place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ROTORID_CACHE", str(tmp_path))


def draws(
    monkeypatch: pytest.MonkeyPatch,
    alike: int = NUMBERS,
    flew: Callable[[int], bool] = lambda n: True,
    seen: float = LOUD,
    asked: list[int] | None = None,
    said: list[str] | None = None,
    effects: Sequence[str] = ("control.delay",),
) -> Draws | str:
    """Of numbers of which some resemble the data and some do not fly; `asked` gets those that had to be flown.

    seen : the data's statistic; the draws' are 1, 2, 3, ...
    """

    def fly(
        request: Request, numbers: Sequence[int], key: str, enough: Callable[[Mapping[int, Any]], object]
    ) -> dict[int, Any]:
        found: dict[int, Any] = {}
        for n in numbers:
            if enough(found) is not None:
                break
            statistics = {"control.delay": 1.0 + n, "unattributed L, curve": 2.0 + n}
            rest = {"statistics": statistics, "sizes": {"control.delay.common": 0.002 * n - 0.02}}
            found[n] = {"alike": n < alike, "effects": list(effects), **(rest if flew(n) else {"statistics": {}})}
            cache.keep(f"{key}/{n}.json", json.dumps(found[n]).encode())
            if asked is not None:
                asked.append(n)
        return found

    monkeypatch.setattr("rotorid_torch.simulation.drawn.data_sets.undrawable", lambda dataset: None)
    monkeypatch.setattr(clean_aircraft, "_fly", fly)
    dataset = flown(linear_vehicle(), manoeuvres(4.0, 0.02), 0.02, noise=0.01)
    observed: Any = Observed({"control.delay": seen, "unattributed L, curve": seen}, {"control.delay": 0.1})
    say = (lambda line: None) if said is None else said.append
    return clean_aircraft.clean_draws(Request(dataset, Null(body_spec(), {}), effects, say=say), observed)


def test_draws_with_more_effects_serve_a_search_with_fewer(monkeypatch: pytest.MonkeyPatch):
    both, asked = ("control.delay", "control.lag"), []
    draws(monkeypatch, effects=both)
    draws(monkeypatch, effects=both[:1], asked=asked)
    assert not asked
    draws(monkeypatch, effects=(*both, "forces.drag"), asked=asked)
    assert asked


def drawn(*given: Any, **named: Any) -> Draws:
    found = draws(*given, **named)
    assert isinstance(found, Draws), found
    return found


LIKENESS = "clean aircraft drawn in the likeness of this one"


@pytest.mark.parametrize(
    ("alike", "note"),
    [
        (NUMBERS, f"critical values come from 19 {LIKENESS}"),
        (
            3,
            f"critical values come from 19 {LIKENESS}, of which 3 resemble it and the others are as near as the drawn"
            " aircraft come",
        ),
    ],
)
def test_the_first_aircraft_that_fly_are_the_draws_whether_they_resemble_the_data_or_not(
    monkeypatch: pytest.MonkeyPatch, alike: int, note: str
):
    found = drawn(monkeypatch, alike)
    assert found.note == note
    assert found.clean
    assert found.least == {"control.delay": 0.1}
    assert found.statistics["control.delay"].tolist() == [1.0 + n for n in range(WANTED)]
    assert found.statistics["unattributed L, curve"].tolist() == [2.0 + n for n in range(WANTED)]
    assert found.sizes["control.delay.common"].tolist() == [0.002 * n - 0.02 for n in range(WANTED)]


def test_an_aircraft_that_flies_away_is_no_draw(monkeypatch: pytest.MonkeyPatch):
    found = drawn(monkeypatch, flew=lambda n: n % 5 != 1)
    assert found.statistics["control.delay"].tolist() == [1.0 + n for n in range(NUMBERS) if n % 5 != 1][:WANTED]


def test_where_too_few_fly_none_are_drawn_and_the_report_says_how_many_did(monkeypatch: pytest.MonkeyPatch):
    assert draws(monkeypatch, flew=lambda n: n < 18) == f"18 of {NUMBERS} drawn aircraft could be flown"


def test_records_that_no_aircraft_can_follow_leave_no_word_of_it_to_the_next(monkeypatch: pytest.MonkeyPatch):
    assert draws(monkeypatch, flew=lambda n: False) == f"0 of {NUMBERS} drawn aircraft could be flown"
    assert len(drawn(monkeypatch).statistics["control.delay"]) == WANTED


def test_draws_stop_when_the_data_show_no_more_than_they_do(monkeypatch: pytest.MonkeyPatch):
    asked: list[int] = []
    found = drawn(monkeypatch, seen=QUIET, asked=asked)
    assert asked == list(range(SETTINGS.earliest))
    assert len(found.statistics["control.delay"]) == SETTINGS.earliest
    assert found.note.startswith(f"critical values come from {SETTINGS.earliest} clean aircraft")


def test_data_that_show_more_fly_those_that_are_missing(monkeypatch: pytest.MonkeyPatch):
    """What an earlier search flew counts, and the numbers that decide are the same as if nothing had been cached."""
    asked: list[int] = []
    drawn(monkeypatch, seen=QUIET)
    found = drawn(monkeypatch, asked=asked)
    assert asked == list(range(SETTINGS.earliest, WANTED))
    assert found.statistics["control.delay"].tolist() == [1.0 + n for n in range(WANTED)]
    again = drawn(monkeypatch, seen=QUIET, asked=asked)
    assert len(asked) == WANTED - SETTINGS.earliest
    assert len(again.statistics["control.delay"]) == SETTINGS.earliest  # not what more of them in the cache would say


def test_a_few_that_fly_are_enough_where_they_show_as_much_as_the_data(monkeypatch: pytest.MonkeyPatch):
    found = drawn(monkeypatch, flew=lambda n: n <= SETTINGS.earliest, seen=QUIET)
    assert len(found.statistics["control.delay"]) == SETTINGS.earliest


def test_what_cannot_be_drawn_is_said_in_words(monkeypatch: pytest.MonkeyPatch):
    dataset = Dataset.from_arrays(small_arrays(), identify=["one", "two", "three"])
    observed: Any = Observed({}, {})
    found = clean_aircraft.clean_draws(request_of(dataset), observed)
    assert found == "the controls lack col, ped"


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda content: b"",
    "cut": lambda content: content[: len(content) // 2],
    "no draw": lambda content: b"{}",
    "no JSON": lambda content: b"ten years of work",
    "edited": lambda content: content.replace(b"4.0", b"9.0"),
    "another type": lambda content: content.replace(b"4.0", b'"4.0"'),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_draws_are_drawn_anew_with_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: str
):
    first = drawn(monkeypatch)
    (folder,) = (tmp_path / "native" / "draws").iterdir()
    for number in (3, 7):
        file = folder / f"{number}.json"
        file.write_bytes(DAMAGES[damage](file.read_bytes()) if number == 3 else b"")
    asked: list[int] = []
    again = drawn(monkeypatch, asked=asked)
    assert asked == [3, 7]
    assert caplog.messages == [f"{folder}: a kept file is cut short or changed; it is not used and made anew"]
    assert torch.equal(again.statistics["control.delay"], first.statistics["control.delay"])
    drawn(monkeypatch, asked=asked)
    assert asked == [3, 7]


def test_draws_without_a_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture):
    monkeypatch.setenv("ROTORID_CACHE", str(tmp_path / "file"))
    (tmp_path / "file").touch()
    assert len(drawn(monkeypatch).statistics["control.delay"]) == WANTED
    (line,) = caplog.messages
    assert line.endswith("nothing can be kept there (Not a directory); it is made anew each time")


def request_of(dataset: Dataset) -> Request:
    return Request(dataset, Null(body_spec(), {}), ["control.delay"])


def test_processes_without_room_end_the_search(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    worker = tmp_path / "worker"
    worker.write_text(f"#!/bin/sh\nexit {NO_ROOM}\n")
    worker.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(worker))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    dataset = flown(linear_vehicle(), manoeuvres(4.0, 0.02), 0.02, noise=0.01)
    with pytest.raises(Unwritable, match=f"{tmp_path}: cannot be written to; expected room for temporary files"):
        clean_aircraft._fly(request_of(dataset), [0, 1], "draws/none", lambda new: None)
    assert [file.name for file in tmp_path.iterdir()] == ["worker"]


DRAWING = """#!{python}
import json, sys, time
from pathlib import Path
request = json.loads(Path(sys.argv[3]).read_text())
for n in request["numbers"][:4]:
    Path(request["folder"], f"{{n}}.json").write_text(json.dumps({{"statistics": {{"control.delay": float(n)}}}}))
time.sleep(600.0)
"""


def test_processes_end_as_soon_as_there_are_enough_draws(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    worker = tmp_path / "worker"
    worker.write_text(DRAWING.format(python=sys.executable))
    worker.chmod(0o755)
    monkeypatch.setenv("ROTORID_THREADS", "1")
    monkeypatch.setattr("sys.executable", str(worker))
    dataset = flown(linear_vehicle(), manoeuvres(4.0, 0.02), 0.02, noise=0.01)
    enough = lambda new: True if len(new) >= 4 else None  # noqa: E731
    begun = time.monotonic()
    found = clean_aircraft._fly(request_of(dataset), list(range(9)), "draws/none", enough)
    assert time.monotonic() - begun < 60.0
    assert {n: draw["statistics"]["control.delay"] for n, draw in found.items()} == {n: float(n) for n in range(4)}
    assert clean_aircraft._read("draws/none", range(9)).keys() == found.keys()  # kept for next time


@pytest.mark.parametrize(
    "file",
    [
        "data/reading/read.py",
        "validate/free_run.py",
        "trace/evidence/critical_values.py",
        "trace/search/decide.py",
        "trace/search/eligible.py",
    ],
)
def test_no_other_version_of_the_package_reads_kept_draws(tmp_path: Path, file: str):
    package = shutil.copytree(
        Path(clean_aircraft.__file__).parents[1], tmp_path / "p", ignore=shutil.ignore_patterns("*.pyc")
    )
    before = clean_aircraft._code(package)
    assert clean_aircraft._code(package) == before
    with (package / file).open("a") as handle:
        handle.write("# another version\n")
    assert clean_aircraft._code(package) != before


def test_another_version_of_an_own_effect_reads_no_kept_draws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    file = tmp_path / "draws_of_my_effect.py"
    text = "from rotorid_torch.effects.base import Effect\n\n\nclass Mine(Effect):\n    id = 'my.effect'\n"
    file.write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    mine = importlib.import_module(file.stem).Mine
    before = clean_aircraft._code()
    monkeypatch.setitem(registered(), "my.effect", mine)
    first = clean_aircraft._code()
    file.write_text(f"{text}    ARM = 9.0\n")
    assert len({before, first, clean_aircraft._code()}) == 3


Statistics = Callable[[object, Null, Sequence[str]], dict[str, Any]]


def worked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, statistics: Statistics) -> dict[str, Any]:
    """What one process tells of three draws, of which the last does not fly."""
    drawn = [SimpleNamespace(number=n, dataset=None, alike=True) for n in range(2)]
    monkeypatch.setattr(
        "rotorid_torch.simulation.drawn.data_sets.clean_flights", lambda dataset, seed, numbers, air: iter(drawn)
    )
    monkeypatch.setattr(clean_aircraft, "statistics_on", statistics)
    data = written(flown(linear_vehicle(), manoeuvres(4.0, 0.02), 0.02, noise=0.01), tmp_path / "data")
    place = tmp_path / "draws"
    place.mkdir()
    clean_aircraft.work(Task(str(data), Null(body_spec(), {}), ["control.delay"], 0, [0, 1, 2], str(place)))
    return {file.stem: json.loads(file.read_text()) for file in place.glob("*.json")}


def test_draws_of_a_process_lie_in_a_file_each(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    found = {"control.delay": 0.1}
    told = worked(monkeypatch, tmp_path, lambda *_: {"statistics": found, "sizes": {}})
    assert {number: draw["statistics"] for number, draw in told.items()} == {"0": found, "1": found, "2": {}}


def failing(error: Exception) -> Statistics:
    def statistics(*_: object) -> dict[str, Any]:
        raise error

    return statistics


@pytest.mark.parametrize("error", [InfiniteCost(), torch.linalg.LinAlgError("no convergence")])
def test_an_aircraft_that_no_fit_begins_from_is_left_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: Exception
):
    assert [draw["statistics"] for draw in worked(monkeypatch, tmp_path, failing(error)).values()] == [{}] * 3


@pytest.mark.parametrize("error", [InputError("f", "k", "w", "e"), RuntimeError("shape"), ValueError("1 of 2 values")])
def test_any_other_fault_is_not_passed_over(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: Exception):
    with pytest.raises(type(error)):
        worked(monkeypatch, tmp_path, failing(error))


def test_a_process_that_fails_is_reported_with_its_last_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    """Controls are missing: nothing can be drawn, which is not asked again before."""
    data = Dataset.from_arrays(small_arrays(), identify=["one", "two", "three"])
    with pytest.raises(RuntimeError, match="the controls lack"):
        clean_aircraft._fly(request_of(data), [0], "draws/none", lambda new: None)
    assert capfd.readouterr().err == ""


def test_clean_aircraft_repeat_the_motion_through_the_air():
    """Head wind of 4 m/s at heading zero, tail wind after half a turn, about a trim at heading zero."""
    spec = body_spec(reference={**body_spec().reference, "psi": 0.0})
    told = {"environment.wind.north": -4.0, "environment.wind.east": 0.0}
    level = dict.fromkeys(("u", "v", "w", "p", "q", "r", "phi", "theta"), torch.zeros(2, dtype=torch.float64))
    flight = Flight(
        "f", 1.0, {"time": torch.arange(2.0), **level, "psi": torch.tensor([0.0, torch.pi], dtype=torch.float64)}
    )
    found = clean_aircraft._through_air(flight, Null(spec, told))
    torch.testing.assert_close(found["u"], torch.tensor([0.0, -8.0], dtype=torch.float64))
    torch.testing.assert_close(found["v"], torch.zeros(2, dtype=torch.float64), atol=1e-12, rtol=0.0)
    assert clean_aircraft._through_air(flight, Null(spec, {})) == {}


def test_a_file_in_the_working_folder_takes_no_part_in_a_worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "random.py").write_text("raise RuntimeError('shadowed')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    request = tmp_path / "request.json"
    request.write_text("{}")
    with worker("rotorid_torch.trace", request) as running:
        running.wait()
    assert request.with_suffix(".log").read_text().endswith("missing required field `dataset`\n")
