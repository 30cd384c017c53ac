"""What every writer of a run or a data set does on a disk that fills up: one error with the place, no thread's word."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from rotorid_torch.core.storage.atomic import Unwritable
from rotorid_torch.data.write import write_dataset
from rotorid_torch.model.nominal import build
from rotorid_torch.model.save import save
from rotorid_torch.run.output.folder import free_run_file, run_folder
from rotorid_torch.run.output.monitor import Monitor
from rotorid_torch.run.output.write import png
from tests.helpers import small_arrays
from tests.known_models import body_spec


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 32 KiB."""
    mounted = ["mount", "-t", "tmpfs", "-o", "size=32k", "tmpfs", str(tmp_path)]
    if subprocess.run(mounted, capture_output=True, check=False).returncode:
        pytest.skip("nothing can be mounted here")
    try:
        yield tmp_path
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)


def a_data_set(out: Path) -> None:
    write_dataset(out, small_arrays(), identify=["one", "two", "three"])


def scalars(out: Path) -> None:
    monitor = Monitor()
    with run_folder(out, "identify") as folder, monitor.recording(folder):
        for iteration in range(10_000):
            monitor.scalars({"ml/cost": 1.0}, iteration)


def pictures(out: Path) -> None:
    monitor, picture = Monitor(), png(Figure(figsize=(3, 3)))
    with run_folder(out, "check") as folder, monitor.recording(folder):
        for iteration in range(100):
            monitor.picture("figure", picture, iteration)


def models(out: Path) -> None:
    spec = body_spec()
    with run_folder(out, "identify") as folder:
        for number in range(100):
            save(build(spec), spec, folder / f"{number}.pt")


def a_free_run(out: Path) -> None:
    with free_run_file(out) as partial, partial.open("wb") as file:
        np.savez(file, time=np.zeros(10_000), p=np.zeros(10_000))  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("write", [a_data_set, scalars, pictures, models, a_free_run])
def test_a_disk_that_fills_up_is_one_error_with_the_place(
    disk: Path, write: Callable[[Path], None], capfd: pytest.CaptureFixture[str]
):
    with pytest.raises(Unwritable, match=f"^{disk}/out: cannot be written to \\(No space left on device\\); expected"):
        write(disk / "out")
    assert not list(disk.iterdir())
    assert capfd.readouterr() == ("", "")
