"""What tables leave to convention: order of quaternions, matrices of motors, clocks that wrap or are dates."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

import rotorid_torch as rotorid
from rotorid_torch.errors import InputError
from tests.importing.log_writers import quaternion
from tests.importing.tables.test_columns import KNOWN, TIME, channels, near
from tests.importing.tables.test_spellings import ANGULAR, MOTORS, NAMES, plain, text

ANGLES = ("phi", "theta", "psi")
Q = quaternion(*(KNOWN[name] for name in ANGLES))
WITHOUT = {name: values for name, values in plain().items() if name not in ANGLES}
LETTERS = ("qw", "qx", "qy", "qz")
QUATERNIONS = {
    "letters": dict(zip(LETTERS, Q, strict=True)),
    "letters, scalar last": {name: Q[i] for name, i in zip(LETTERS[1:] + LETTERS[:1], (1, 2, 3, 0), strict=True)},
    "counted from one": {f"q{i + 1}": Q[i] for i in range(4)},
    "columns": {f"q[{i}]": Q[i] for i in range(4)},
    "letters in capitals": {name.upper(): Q[i] for i, name in enumerate(LETTERS)},
    "figures in capitals": {f"Q{i}": Q[i] for i in range(4)},
    "vector first": {f"q{i}": Q[(1, 2, 3, 0)[i]] for i in range(4)},
    "the other way": {f"q{i}": Q[i] * (1.0 if i == 0 else -1.0) for i in range(4)},
    "left and up": {f"q{i}": Q[i] * (1.0, 1.0, -1.0, -1.0)[i] for i in range(4)},
    "left and up, vector first": {f"q{i}": Q[j] * (1.0, 1.0, -1.0, -1.0)[j] for i, j in enumerate((1, 2, 3, 0))},
    "sign that changes": {f"q{i}": Q[i] * np.where(TIME > 3.0, -1.0, 1.0) for i in range(4)},
}


@pytest.mark.parametrize("form", QUATERNIONS)
def test_quaternions_are_read_in_the_order_that_the_rates_say(form: str, tmp_path: Path):
    others = {name.upper(): values for name, values in WITHOUT.items()} if "capitals" in form else WITHOUT
    (tmp_path / "t.csv").write_text(text({**others, **QUATERNIONS[form]}))
    done = rotorid.import_log(tmp_path / "t.csv", tmp_path / "other")
    assert any("by the body rates" in said for said in done.warnings) == any(
        word in form for word in ("vector first", "the other way", "left and up")
    )
    assert not any("confirm" in said for said in done.warnings)
    assert near(channels(tmp_path / "t.csv", tmp_path), 1e-3, " ".join(NAMES))


def test_turns_about_one_axis_name_every_way_that_they_allow(tmp_path: Path):
    still, turn = 0.0 * TIME, 0.5 * np.sin(TIME)
    columns = {**WITHOUT, "p": still, "q": still, "r": 0.5 * np.cos(TIME)}
    q = quaternion(still, still, turn) * np.array([1.0, 1.0, -1.0, -1.0])[:, None]
    (tmp_path / "t.csv").write_text(text({**columns, **{f"q{i}": q[i] for i in range(4)}}))
    done = rotorid.import_log(tmp_path / "t.csv", tmp_path / "s")
    (said,) = (one for one in done.warnings if "by the body rates" in one)
    assert "from north-east-down to body axes or in axes to the front, left and up" in said


def test_a_quaternion_of_noise_keeps_its_order(tmp_path: Path):
    noise = np.random.default_rng(0).standard_normal((4, len(TIME)))
    noise /= np.linalg.norm(noise, axis=0)
    (tmp_path / "t.csv").write_text(text({**WITHOUT, **{f"q{i}": noise[i] for i in range(4)}}))
    done = rotorid.import_log(tmp_path / "t.csv", tmp_path / "s")
    assert not any("by the body rates" in said for said in done.warnings)
    assert sum("q0 q1 q2 q3 are taken scalar first" in said for said in done.warnings) == 1


def test_an_order_that_no_rates_confirm_is_a_warning(tmp_path: Path):
    columns = {name: values for name, values in WITHOUT.items() if name != "r"}
    (tmp_path / "t.csv").write_text(text({**columns, **QUATERNIONS["counted from one"]}))
    done = rotorid.import_log(tmp_path / "t.csv", tmp_path / "s")
    assert sum("q1 q2 q3 q4 are taken scalar first" in said for said in done.warnings) == 1


def test_columns_of_a_matrix_in_capitals_are_motors(tmp_path: Path):
    columns = {n.upper(): v for n, v in plain().items() if n not in MOTORS}
    columns |= {f"MOTOR[{i}]": KNOWN[name] for i, name in enumerate(MOTORS)}
    (tmp_path / "t.csv").write_text(text(columns))
    assert near(channels(tmp_path / "t.csv", tmp_path), 1e-6, " ".join(NAMES))


def test_columns_of_a_matrix_are_motors(tmp_path: Path):
    rates = {name: KNOWN[name] for name in "pqr"}
    np.savez(tmp_path / "m.npz", time=TIME, motor=np.stack([KNOWN[m] for m in MOTORS], 1), quaternion=Q.T, **rates)
    assert near(channels(tmp_path / "m.npz", tmp_path), 1e-6, " ".join(NAMES))


def test_structs_have_the_clock_of_the_struct_around_them(tmp_path: Path):
    import scipy.io

    parts = {"rates": ("p", "q", "r"), "attitude": ANGLES, "out": tuple(MOTORS)}
    content = {"time": TIME, **{part: {n: KNOWN[n] for n in some} for part, some in parts.items()}}
    scipy.io.savemat(tmp_path / "s.mat", {"log": content})
    assert near(channels(tmp_path / "s.mat", tmp_path), 1e-6, " ".join(NAMES))


ENDS = {"us": 2.0**32, "ticks": 2.0**24, "ms": 2.0**16, "week": 604800.0, "day": 86400.0}


def written(form: str) -> tuple[str, list[str]]:
    """Name of the clock's column and its stamps, half of the flight before the clock ends and half after."""
    end, half = ENDS[form], TIME[len(TIME) // 2]
    count = {"us": 1e6, "ticks": 1e6, "ms": 1e3, "week": 1.0, "day": 1.0}[form]
    stamps = [(end + count * (t - half)) % end for t in TIME]
    if form == "day":
        return "time", [f"{int(s // 3600):02d}:{int(s // 60) % 60:02d}:{s % 60:06.3f}" for s in stamps]
    return {"us": "time_us", "ticks": "time_us", "ms": "time_ms", "week": "time"}[form], [
        f"{stamp:.6f}" for stamp in stamps
    ]


@pytest.mark.parametrize("form", ENDS)
def test_a_clock_that_ends_what_it_counts_to_runs_on(form: str, tmp_path: Path):
    name, stamps = written(form)
    others = {n: v for n, v in plain().items() if n != "time"}
    (tmp_path / "t.csv").write_text(text({name: stamps, **others}))
    assert near(channels(tmp_path / "t.csv", tmp_path), 1e-3, " ".join((*ANGULAR, *MOTORS)))


def dated(begun: datetime, form: str) -> str:
    """A table whose clock are dates."""
    moments = [begun + timedelta(seconds=float(t)) for t in TIME]
    others = {n: v for n, v in plain().items() if n != "time"}
    return text({"timestamp": [moment.strftime(form) for moment in moments], **others})


@pytest.mark.parametrize("form", ["%d/%m/%Y %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S.%f", "%d-%m-%Y %H:%M:%S.%f"])
@pytest.mark.parametrize("day", [(2024, 2, 29), (2024, 12, 12), (2024, 1, 31), (2024, 12, 31), (2024, 3, 3)])
def test_dates_of_either_order_are_a_clock_where_one_of_them_fits(form: str, day: tuple, tmp_path: Path):
    """Over midnight: of 12/12/2024 and 12/13/2024 the second one tells. 3/3 and 3/4 do not."""
    (tmp_path / "t.csv").write_text(dated(datetime(*day, 23, 59, 56, tzinfo=UTC), form))
    if day == (2024, 3, 3):
        with pytest.raises(InputError, match=r"timestamp: is 03.03.2024, then .*: day or month first\?; expected"):
            rotorid.import_log(tmp_path / "t.csv", tmp_path / "s")
    else:
        assert near(channels(tmp_path / "t.csv", tmp_path), 1e-3, " ".join(NAMES))


def test_within_a_day_the_order_of_a_date_does_not_matter(tmp_path: Path):
    (tmp_path / "t.csv").write_text(dated(datetime(2024, 3, 4, 9, 5, 6, tzinfo=UTC), "%d/%m/%Y %H:%M:%S.%f"))
    assert near(channels(tmp_path / "t.csv", tmp_path), 1e-3, " ".join(NAMES))


def test_dates_of_two_orders_are_refused(tmp_path: Path):
    table = dated(datetime(2024, 2, 29, 23, 59, 56, tzinfo=UTC), "%d/%m/%Y %H:%M:%S.%f")
    (tmp_path / "t.csv").write_text(table.replace("01/03/2024", "03/13/2024"))
    with pytest.raises(InputError, match=r"timestamp: is '29/02/2024 23:59:56.000000' in line 2; expected"):
        rotorid.import_log(tmp_path / "t.csv", tmp_path / "s")


@pytest.mark.parametrize("form", ["T", " ", "Z", ".", "/"])
def test_dates_are_a_clock(form: str, tmp_path: Path):
    begun = datetime(2024, 2, 29, 23, 59, 56, tzinfo=UTC)
    mark, zone = form.replace("Z", "T"), "Z" if form == "Z" else ""
    moments = [(begun + timedelta(seconds=float(t))).replace(tzinfo=None) for t in TIME]
    others = {n: v for n, v in plain().items() if n != "time"}
    forms = {".": "%d.%m.%Y %H:%M:%S.%f", "/": "%Y/%m/%d %H:%M:%S.%f"}
    texts = [m.strftime(forms[form]) if form in forms else m.isoformat(mark) + zone for m in moments]
    (tmp_path / "t.csv").write_text(text({"timestamp": texts, **others}))
    assert near(channels(tmp_path / "t.csv", tmp_path), 1e-3, " ".join(NAMES))


def test_a_clock_of_words_is_refused(tmp_path: Path):
    others = {n: v for n, v in plain().items() if n != "time"}
    (tmp_path / "t.csv").write_text(text({"time": ["25 o'clock"] * len(TIME), **others}))
    with pytest.raises(InputError, match=r"time: is '25 o'clock' in line 2; expected .*, or a time as 2024-02-29"):
        rotorid.import_log(tmp_path / "t.csv", tmp_path / "s")


OTHERS = {
    "time_ms": ("timestamp", 1.7e9 + np.floor(TIME), 1e3),
    "time": ("t", 25.0 + 1e-3 * TIME, 1.0),
    "TIME": ("T", 25.0 + 0.01 * np.sin(40.0 * TIME), 1.0),
}


@pytest.mark.parametrize("clock", OTHERS)
def test_of_several_clocks_one_that_runs_is_taken(clock: str, tmp_path: Path):
    """Beside whole seconds and a temperature, which stand before it."""
    other, values, count = OTHERS[clock]
    columns = {n.upper() if clock.isupper() else n: v for n, v in plain().items() if n != "time"}
    (tmp_path / "t.csv").write_text(text({other: values, clock: count * TIME, **columns}))
    done = rotorid.import_log(tmp_path / "t.csv", tmp_path / "set")
    assert f"t.csv: {other} left out: the clock is {clock}" in done.warnings
    (flight,) = rotorid.load(done.folder).flights.values()
    assert near({name: values.numpy() for name, values in flight.channels.items()}, 1e-3, " ".join(NAMES))


def test_a_table_with_a_row_for_every_message_has_the_rates_of_its_channels(tmp_path: Path):
    rates = {**dict.fromkeys("pqr", 1), **dict.fromkeys(ANGULAR[3:], 2), **dict.fromkeys(MOTORS, 10)}
    stamps = np.sort(np.concatenate([TIME + 1e-3 * every for every in (1, 2, 10)]))
    columns = {"time": [f"{stamp:.6f}" for stamp in stamps]}
    for name, every in rates.items():
        wanted = dict.fromkeys(np.round(TIME[::every] + 1e-3 * every, 6))
        values = np.interp(stamps, TIME, KNOWN[name])
        columns[name] = [f"{v:.9g}" if round(s, 6) in wanted else "" for s, v in zip(stamps, values, strict=True)]
    lines = [",".join(columns), *(",".join(row) for row in zip(*columns.values(), strict=True))]
    (tmp_path / "t.csv").write_text("\n".join(lines))
    done = rotorid.import_log(tmp_path / "t.csv", tmp_path / "set")
    assert done.rate == 100.0
    assert any("motor4 recorded at 10 Hz, the body rates at 100 Hz" in told for told in done.warnings)


def test_a_vector_that_never_changes_gives_way_to_its_other_form(tmp_path: Path):
    zero = dict.fromkeys(("u", "v", "w"), 0.0 * TIME)
    velocity = {name: KNOWN[name] for name in ("vn", "ve", "vd")}
    (tmp_path / "t.csv").write_text(text({**plain(), **zero, **velocity}))
    done = rotorid.import_log(tmp_path / "t.csv", tmp_path / "set")
    assert "t.csv: u, v, w never change: taken from vn, ve, vd" in done.warnings
    (flight,) = rotorid.load(done.folder).flights.values()
    found = np.sqrt(sum(flight.channels[name].numpy() ** 2 for name in "uvw"))
    assert found[5:-5] == pytest.approx(np.sqrt(sum(v**2 for v in velocity.values()))[5:-5], abs=1e-2)


@pytest.mark.parametrize("name", ["time [h:mm:ss]", "Time (HH:MM:SS.sss)", "time [UTC]"])
def test_a_time_of_day_may_say_its_form_and_pass_midnight(name: str, tmp_path: Path):
    stamps = [86390.0 + 0.02 * k for k in range(1000)]
    texts = [f"{int(s % 86400 // 3600):02}:{int(s % 3600 // 60):02}:{s % 60:06.3f}" for s in stamps]
    rows = [f"{text},{0.1 * np.sin(0.02 * k):.6f}" for k, text in enumerate(texts)]
    file = tmp_path / "day.csv"
    file.write_text("\n".join([f"{name},lon", *rows]))
    rotorid.import_log(file, tmp_path / "set")
    (flight,) = rotorid.load(tmp_path / "set").flights.values()
    assert (flight.samples, flight.dt) == (1000, pytest.approx(0.02))
    assert np.abs(flight["lon"].numpy() - 0.1 * np.sin(0.02 * np.arange(1000))).max() < 1e-5


def test_moments_of_numpy_are_a_clock(tmp_path: Path):
    time = np.arange(0.0, 20.0, 0.01)
    moments = np.datetime64("2026-03-01T12:00", "us") + (time * 1e6).round().astype("timedelta64[us]")
    np.savez(tmp_path / "log.npz", time=moments, lon=0.1 * np.sin(time))
    rotorid.import_log(tmp_path / "log.npz", tmp_path / "set")
    (flight,) = rotorid.load(tmp_path / "set").flights.values()
    assert flight.dt == pytest.approx(0.01)
    assert np.abs(flight["lon"].numpy() - 0.1 * np.sin(time)).max() < 1e-5
