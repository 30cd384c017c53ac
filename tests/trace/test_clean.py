"""Floors come from clean aircraft that resemble the data; where too few do, from those that come nearest."""

from __future__ import annotations

import importlib
import json
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from rotorid_torch.core.ranks import ALONE
from rotorid_torch.data.flight import Flight
from rotorid_torch.effects.registry import registered
from rotorid_torch.errors import InputError
from rotorid_torch.identification.gauss_newton import InfiniteCost
from rotorid_torch.trace import clean
from rotorid_torch.trace.floor import Floors, Null
from tests.known_models import body_spec, flown, linear_vehicle, manoeuvres, written

DRAWS = 24


def floors(monkeypatch: pytest.MonkeyPatch, place: Path, alike: int, flew: int) -> Floors:
    """Of draws of which some resemble the data and some do not fly."""

    def fly(*request: Any) -> None:
        numbers: Sequence[int] = request[4]
        folder: Path = request[5]
        for n in numbers:
            gains = {"control.delay": 0.001 * n} if n < flew else {}
            others = {"traces": {"X": 0.1}, "forces": {"mass.slung_load": 0.01 * n}, "each_control": gains}
            others["sizes"] = {"control.delay.common": 0.002 * n - 0.02}
            rest = others if gains else {}
            said = {"gains": gains, "alike": n < alike, **rest}
            clean._keep(folder, n, said | {"misfit": 1.0 + n})

    monkeypatch.setattr("rotorid_torch.fly.drawn.undrawable", lambda dataset: None)
    monkeypatch.setattr(clean, "cache_folder", lambda: place)
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
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, alike: int, flew: int, counted: int, said: str
):
    found = floors(monkeypatch, tmp_path, alike, flew)
    assert found.note == said
    assert sorted(found.gains.get("control.delay", [])) == pytest.approx([0.001 * n for n in range(counted)])
    assert sorted(found.in_forces.get("mass.slung_load", [])) == pytest.approx([0.01 * n for n in range(counted)])
    assert sorted(found.sizes.get("control.delay.common", [])) == pytest.approx(
        [0.002 * n - 0.02 for n in range(counted)]
    )


def test_records_that_no_aircraft_can_follow_leave_no_word_of_it_to_the_next(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    assert not floors(monkeypatch, tmp_path, 0, 0).gains
    assert len(floors(monkeypatch, tmp_path, 24, 24).gains["control.delay"]) == DRAWS


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


def worked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, gains: Gains, waited_for: bool = True) -> dict[str, Any]:
    """What one process keeps of three draws."""
    drawn = [SimpleNamespace(number=n, dataset=None, alike=True, misfit=1.0, rotor="") for n in range(3)]
    monkeypatch.setattr("rotorid_torch.fly.drawn.clean_flights", lambda dataset, seed, numbers: iter(drawn))
    monkeypatch.setattr(clean, "gains_on", gains)
    data = written(flown(linear_vehicle(), manoeuvres(4.0, 0.02), 0.02, noise=0.01), tmp_path / "data")
    place = tmp_path / "floors"
    place.mkdir()
    plain = {"dataset": str(data), "spec": body_spec().plain(), "values": {}, "held": [], "effects": ["control.delay"]}
    parent = os.getppid() if waited_for else -1
    clean._work({**plain, "seed": 0, "numbers": [0, 1, 2], "folder": str(place), "parent": parent})
    return {file.stem: json.loads(file.read_text()) for file in place.glob("*.json")}


@pytest.mark.parametrize("waited_for", [True, False])
def test_who_draws_for_a_process_that_is_gone_stops(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, waited_for: bool):
    kept = worked(monkeypatch, tmp_path, lambda *_: {"gains": {"control.delay": 0.1}}, waited_for)
    assert len(kept) == (3 if waited_for else 0)


def failing(error: Exception) -> Gains:
    def gains(*_: object) -> dict[str, Any]:
        raise error

    return gains


@pytest.mark.parametrize("error", [InfiniteCost(), torch.linalg.LinAlgError("no convergence")])
def test_an_aircraft_that_no_fit_begins_from_is_left_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: Exception
):
    assert worked(monkeypatch, tmp_path, failing(error)) == {}


@pytest.mark.parametrize("error", [InputError("f", "k", "w", "e"), RuntimeError("shape"), ValueError("1 of 2 values")])
def test_any_other_fault_is_not_passed_over(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: Exception):
    with pytest.raises(type(error)):
        worked(monkeypatch, tmp_path, failing(error))


def test_a_process_that_fails_is_reported_with_its_last_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    """No rotor is declared: nothing can be drawn, which is not asked again before."""
    data = flown(linear_vehicle(), manoeuvres(4.0, 0.02), 0.02, noise=0.01)
    with pytest.raises(RuntimeError, match="radius of the main rotor is not declared"):
        clean._fly(data, Null(body_spec(), {}), ["control.delay"], 0, [0], tmp_path, ALONE)
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
