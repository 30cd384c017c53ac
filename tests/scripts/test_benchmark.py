"""Parts of the benchmark: figures held against bars, medians of programs in turn, data sets of many flights."""

import importlib
from pathlib import Path
from types import ModuleType

import pytest

from rotorid_torch.data.dataset import load
from tests.helpers import ROOT, small_folder


@pytest.fixture
def part(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))

    def load_part(name: str) -> ModuleType:
        return importlib.import_module(f"benchmark.{name}")

    return load_part


@pytest.mark.parametrize(
    ("sense", "value", "ratio", "met"),
    [
        ("ratio at most", 9.0, 1.9, True),
        ("ratio at most", 1.0, 2.1, False),
        ("ratio at least", 1.0, 2.1, True),
        ("ratio at least", 9.0, 1.9, False),
        ("value at most", 1.9, None, True),
        ("value at most", 2.1, 1.0, False),
    ],
)
def test_a_figure_is_held_against_its_bar(part, sense: str, value: float, ratio: float | None, met: bool) -> None:
    rows = part("rows")
    row, figure = rows.Row("x", "", sense, 2.0), rows.Figure(value, "s", "other", ratio)
    assert rows.judged(row, figure).met is met
    assert rows.judged(row, None).met is None


def test_every_row_has_a_name_of_its_own(part) -> None:
    names = [row.name for row in part("rows").ROWS]
    assert len(set(names)) == len(names)


def test_programs_run_in_turn(part) -> None:
    order: list[str] = []
    programs = {name: lambda name=name: order.append(name) for name in "ab"}
    seconds = part("clock").interleaved(programs, 3)
    assert order == list("ababab")
    assert all(0.0 <= s < 0.1 for s in seconds.values())


def test_a_failing_process_says_why(part) -> None:
    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        part("clock").process("-c", "1 / 0")


def test_many_flights_are_the_given_ones_with_fresh_noise(part, tmp_path: Path) -> None:
    given = load(small_folder(tmp_path / "few"))
    many = load(part("processes").repeated(given, 3, tmp_path / "many"))
    first, second = (many.flights[name].channels["p"] for name in many.identify[:2])
    noise = given.noise("p")
    assert len(many.identify) == 3
    assert many.validate == given.validate
    assert 1.2 * noise < float((first - second).std()) < 1.6 * noise
    assert float((first - given.flights["one"].channels["p"]).std()) < 1.2 * noise
    assert bool((many.flights["two"].channels["p"] == given.flights["two"].channels["p"]).all())
