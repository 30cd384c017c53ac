"""What a table needs to be read is said in one line: names, points in numbers, the clock's unit, names of channels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rotorid_torch as rotorid
from rotorid_torch.errors import InputError

NAMES = ("time", "motor1", "motor2", "motor3", "motor4", "p", "q", "r")


def rows(hertz: float = 50.0, count: int = 300) -> np.ndarray:
    time = np.arange(count) / hertz
    return np.stack([time, *(0.5 + 0.1 * np.sin(time * (i + 1) / hertz * 50.0) for i in range(len(NAMES) - 1))], axis=1)


def written(file: Path, lines: list[str], header: str = ",".join(NAMES)) -> Path:
    file.write_text("\n".join(filter(None, [header, *lines])) + "\n")
    return file


def lines_of(values: np.ndarray, mark: str = ",") -> list[str]:
    return [mark.join(f"{v:.6f}" for v in row) for row in values]


@pytest.mark.parametrize("clock", ["time [s]", "time_s", "time (seconds)"])
def test_a_clock_whose_header_names_seconds_is_believed_at_1_hz(clock: str, tmp_path: Path):
    header = ",".join((clock, *NAMES[1:]))
    assert rotorid.import_log(written(tmp_path / "a.csv", lines_of(rows(1.0)), header), tmp_path / "set").rate == 1.0


def test_a_count_without_a_unit_is_no_second(tmp_path: Path):
    with pytest.raises(InputError, match='unit = "ms"'):
        rotorid.import_log(written(tmp_path / "a.csv", lines_of(rows(1.0))), tmp_path / "set")


def test_a_table_without_names_is_told_how_to_name_them(tmp_path: Path):
    with pytest.raises(InputError, match=r"no row of names; expected one, or a map with columns"):
        rotorid.import_log(written(tmp_path / "a.csv", lines_of(rows()), ""), tmp_path / "set")


def test_decimal_commas_between_commas_are_told(tmp_path: Path):
    lines = [line.replace(".", ",") for line in lines_of(rows())]
    with pytest.raises(InputError, match="decimal commas between commas"):
        rotorid.import_log(written(tmp_path / "a.csv", lines), tmp_path / "set")


@pytest.mark.parametrize("missing", ["--", "#N/A", "NaN", "N/A", "", "-nan(ind)", "1.#QNAN", "---"])
def test_words_for_a_missing_sample(missing: str, tmp_path: Path):
    lines = lines_of(rows())
    lines[100] = ",".join([*lines[100].split(",")[:-1], missing])
    rotorid.import_log(written(tmp_path / "a.csv", lines), tmp_path / "set")
    assert (tmp_path / "set" / "dataset.toml").exists()


def test_names_of_other_people_are_answered_by_lines_of_a_map(tmp_path: Path):
    header = "time,motor1,motor2,moter3,motor4,gyro_x,roll,Yaw_Rate"
    done = rotorid.import_log(written(tmp_path / "a.csv", lines_of(rows()), header), tmp_path / "set")
    (hint,) = [warning for warning in done.warnings if "a map" in warning]
    for line in (
        'p = { field = "gyro_x"',
        'phi = { field = "roll"',
        'motor3 = { field = "moter3"',
        'r = { field = "Yaw_Rate"',
    ):
        assert line in hint


@pytest.mark.parametrize(("name", "meant"), [("Motor{}", "motor1 = 'Motor1'"), ("thrust{}", "lon = 'FIELD'")])
def test_a_table_without_a_control_is_answered_by_a_line_of_a_map(name: str, meant: str, tmp_path: Path):
    header = ",".join(("time", *(name.format(i) for i in range(1, 5)), "p", "q", "r"))
    with pytest.raises(InputError, match=f"no control that is known .* as {meant} below"):
        rotorid.import_log(written(tmp_path / "a.csv", lines_of(rows()), header), tmp_path / "set")


def test_rows_in_another_order_are_no_other_unit_of_the_clock(tmp_path: Path):
    shuffled = np.random.default_rng(0).permutation(rows())
    with pytest.raises(InputError, match="runs back"):
        rotorid.import_log(written(tmp_path / "a.csv", lines_of(shuffled)), tmp_path / "set")


def test_what_is_said_of_several_logs_is_said_once(tmp_path: Path):
    header = ",".join((*NAMES[:-1], "something"))
    files = [written(tmp_path / f"{n}.csv", lines_of(rows() + 0.001 * i), header) for i, n in enumerate("abc")]
    done = rotorid.import_log(files, tmp_path / "set")
    assert done.warnings == (
        "a.csv: left out, for no channel has such a name and unit: something (likewise in b.csv, c.csv)",
    )


def test_a_flight_with_another_unit_is_refused_by_its_file(tmp_path: Path):
    time = np.arange(0.0, 12.0, 0.02)
    phi = 0.3 * np.sin(2.0 * time)
    p = np.gradient(np.degrees(phi), 0.02)
    table = np.stack([time, *(0.5 + 0.1 * np.cos(time * i) for i in range(1, 5)), p, 0.0 * p, 0.0 * p, phi], axis=1)
    header = ",".join((*NAMES, "phi"))
    with pytest.raises(InputError, match=r"a.csv: p: is .* expected rad/s; a map \(--map\) says a field's unit"):
        rotorid.import_log(written(tmp_path / "a.csv", lines_of(table), header), tmp_path / "set")
