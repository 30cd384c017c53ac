"""The monitor: silent without a console, and complete in the folder with one."""

from __future__ import annotations

import io
import re
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from rotorid_torch.run.output.monitor import Monitor, peak_memory_mb
from rotorid_torch.run.output.write import png


def test_folder_holds_scalars_figures_log_and_warnings(tmp_path: Path):
    monitor = Monitor()
    with monitor.recording(tmp_path):
        for iteration, cost in enumerate((3.0, 2.0, 1.5)):
            monitor.scalars({"ml/cost": cost}, iteration)
        monitor.picture("overlay/p", png(Figure(figsize=(1, 1))), 2)
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.warn("a rotor without blades", UserWarning, stacklevel=1)
        monitor.say("done")
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert [(e.step, e.value) for e in events.Scalars("ml/cost")] == [(0, 3.0), (1, 2.0), (2, 1.5)]
    assert events.Tags()["images"] == ["overlay/p"]
    log = (tmp_path / "log.txt").read_text()
    assert "ml/cost 1.5" in log
    assert "a rotor without blades" in log
    assert log.splitlines()[-1].endswith("done")


def test_each_fit_has_a_folder_of_its_own_and_words_are_recorded(tmp_path: Path):
    monitor = Monitor()
    with monitor.recording(tmp_path):
        for cost in (3.0, 2.0):
            with monitor.fit("none") as record:
                record({"ml/cost": cost, "parameters/forces.L.p": -cost}, 0)
        assert monitor.board is not None
        monitor.board.text("verdict", "The controls are **late**.")
        monitor.board.scalars({"scores/before/acid": 0.3}, 0)
    folders = sorted(place.name for place in (tmp_path / "tensorboard").iterdir() if place.is_dir())
    assert folders == ["01-none", "02-none"]
    each = [EventAccumulator(str(tmp_path / "tensorboard" / name)).Reload() for name in folders]
    assert [events.Scalars("ml/cost")[0].value for events in each] == [3.0, 2.0]
    assert each[1].Scalars("parameters/forces.L.p")[0].value == -2.0
    whole = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert whole.Tensors("verdict")[0].tensor_proto.string_val == [b"The controls are **late**."]
    assert whole.SummaryMetadata("verdict").plugin_data.plugin_name == "text"
    with Monitor().fit("nowhere") as record:
        record({"ml/cost": 1.0}, 0)


def test_without_console_and_folder_nothing_is_told(capfd: pytest.CaptureFixture[str]):
    monitor = Monitor()
    with monitor.step("ml"):
        monitor.progress(1, 3)
        monitor.scalars({"ml/cost": 1.0}, 0)
        monitor.picture("overlay", b"")
    monitor.say("done")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("terminal", [False, True])
def test_console_hears_steps_with_their_time(terminal: bool):
    written = io.StringIO()
    monitor = Monitor(Console(file=written, force_terminal=terminal, width=80, highlight=False), verbose=True)
    with monitor.step("reconstruct"):
        monitor.progress(2, 2)
    assert re.search(r"\d\.\d s  motion, forces and moments from the sensors", written.getvalue())


@pytest.mark.parametrize("verbose", [False, True])
def test_lines_for_developers_are_shown_to_those_who_ask(tmp_path: Path, verbose: bool):
    written = io.StringIO()
    monitor = Monitor(Console(file=written, width=80), verbose=verbose)
    with monitor.recording(tmp_path):
        monitor.say("control.delay: gain 0.3")
        monitor.tell("clean aircraft 7 of at most 24")
    assert ("gain 0.3" in written.getvalue()) == verbose
    assert "clean aircraft 7" in written.getvalue()
    assert "gain 0.3" in (tmp_path / "log.txt").read_text()


def test_clock_adds_up_steps_of_one_name_and_goes_on_after_an_error():
    monitor = Monitor()
    for _ in range(2):
        with monitor.step("ml"):
            pass
    with pytest.raises(ZeroDivisionError), monitor.step("ftr"):
        _ = 1 / 0
    record = monitor.time_record()
    assert record.ml == monitor.seconds["ml"]
    assert set(monitor.seconds) == {"ml", "ftr"}
    assert record.total is not None
    assert record.total >= sum(monitor.seconds.values())


def test_peak_memory_is_that_of_a_process_with_torch():
    assert 20 < peak_memory_mb() < 1e5


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="told by /proc")
def test_peak_memory_is_not_that_of_the_program_that_started_it():
    large = np.ones(40_000_000)  # 320 MB, which a child's own count by the system would hold
    child = "from rotorid_torch.run.output.monitor import peak_memory_mb; print(peak_memory_mb())"
    told = subprocess.run([sys.executable, "-c", child], capture_output=True, text=True, check=True).stdout
    assert float(told) < large.nbytes / 1024**2 < peak_memory_mb()
