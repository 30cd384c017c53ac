"""The folder of a run: written beside its place and renamed when complete, so that it is whole or absent."""

import os
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

import msgspec

from rotorid_torch.core.storage.atomic import atomic_file, atomic_folder, refuse_unless_writable, restore
from rotorid_torch.core.storage.files import read_file
from rotorid_torch.core.storage.paths import absolute, is_part, refuse_foreign, same_file
from rotorid_torch.data.reading.read import FOLDERS
from rotorid_torch.data.write import FILES as DATASET_FILES
from rotorid_torch.errors import InputError
from rotorid_torch.printable import printable
from rotorid_torch.report.records import LARGEST

FILES = (
    *("report.json", "report.html", "model.pt", "check.json", "log.txt"),
    *("reconstruct/*.npz", "gusts/*.npz", "figures/*.png", "tensorboard/*"),
)
"""Files of a run: a folder that holds others is not replaced."""
ALIKE = (("check",), ("reconstruct",), ("identify", "close-loop"))
"""Commands whose runs replace each other; a run with a model is not replaced by one without."""
DOCUMENTS = (
    *(".csv", ".doc", ".docx", ".htm", ".html", ".json", ".md", ".npz", ".odt", ".pdf", ".png", ".pt", ".svg", ".tex"),
    *(".txt", ".xlsx", ".zip"),
)
"""Endings of files that are asked for in place of a run, which is a folder."""
FREE_RUN = b"rotorid: free run, format 1"
"""Comment of the archive that `simulate` writes: what lies there and has it may be replaced."""
FREE_RUNS = (".npz", ".csv", "")
"""Endings of free runs; what has none is an npz."""


@contextmanager
def run_folder(out: str | Path, command: str) -> Iterator[Path]:
    """Give a folder to write a command's run into; it takes the place `out` when the block ends without an exception.

    Until then an earlier run at `out` stays as it is; on an exception (Ctrl-C too) what was written is removed.

    Raises InputError: at once, where `out` is in the way and no run that `command` replaces, or its parent is missing
    or cannot be written to.
    """
    place = absolute(out)
    with atomic_folder(place, lambda: refuse_unless_free(place, command)) as folder:
        yield folder


@contextmanager
def free_run_file(out: str | Path, *, overwrite: bool = False, inputs: Iterable[Path] = ()) -> Iterator[Path]:
    """Give a file name beside `out` to write to; an npz is marked as a free run. It is renamed when the block ends.

    overwrite, inputs : as `refuse_unless_free_run`.

    Raises InputError: as `refuse_unless_free_run`, at once and again before the file is renamed.
    """
    place, inputs = absolute(out), tuple(inputs)
    refuse = partial(refuse_unless_free_run, place, overwrite=overwrite, inputs=inputs)
    with atomic_file(place, refuse) as file:
        yield file
        if is_table(place):
            return
        with zipfile.ZipFile(file, "a") as archive:
            archive.comment = FREE_RUN


def refuse_unless_free_run(out: str | Path, *, overwrite: bool = False, inputs: Iterable[Path] = ()) -> None:
    """Raise InputError where no free run can be written to `out`.

    Another file lies there, or it would be a file of a run or a data set; or the parent is no use.

    overwrite : replace other files too.
    inputs : files that are read, which nothing replaces, whatever their names.
    """
    place = absolute(out)
    if os.path.isdir(place):
        raise InputError(out, "", "is a folder", "the name of a file to write")
    same = same_file(place, inputs)
    if same is not None:
        raise InputError(out, "", f"is the file {same}, which is read", "another name")
    whole = _part_of(place)
    if whole is not None:
        raise InputError(out, "", f"has the name of a file of {whole}", "another name")
    if os.path.lexists(place) and not is_free_run(place):
        if place.exists() and not place.is_file():
            raise InputError(out, "", "is in the way and is not a file", "a new name")
        if not overwrite:
            wrong = "is in the way and is not a free run that simulate wrote"
            raise InputError(out, "", wrong, "a new name, or --overwrite to replace the file")
    if place.suffix.lower() not in FREE_RUNS:
        raise InputError(out, "", f"'{place.suffix}' is no format of a free run", "a name that ends in .npz or .csv")
    refuse_unless_writable(place)


def is_table(out: str | Path) -> bool:
    """Whether a free run of this name is written as a table of text."""
    return Path(out).suffix.lower() == ".csv"


def _part_of(place: Path) -> Path | None:
    """The run or the data set that has files of this name."""
    real = place.parent.resolve() / place.name
    for folder in list(real.parents)[:2]:
        name = real.relative_to(folder).as_posix()
        declared = os.path.isfile(folder / "dataset.toml")
        if (declared and is_part(name, DATASET_FILES)) or (is_part(name, FILES) and command_of(folder) is not None):
            return folder
    return None


def is_free_run(path: Path) -> bool:
    """Whether `path` is a file that `simulate` wrote: a zip archive that ends with our comment."""
    if path.is_symlink() or not path.is_file():
        return False
    with suppress(OSError), path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 22 - len(FREE_RUN)))  # 22 bytes: end of central directory of a zip
        end = file.read(22 + len(FREE_RUN))
        return end.startswith(b"PK\5\6") and end.endswith(FREE_RUN)
    return False


def refuse_unless_free(out: str | Path, command: str) -> None:
    """Raise InputError where a command's run cannot be written to `out`.

    Something lies there that is not a run of the command's kind, or holds files that are not of a run; or the parent is
    no use.
    """
    place = absolute(out)
    refuse_unless_writable(place)
    above = place.parent.resolve()
    if above.name in FOLDERS and (above.parent / "dataset.toml").is_file():
        raise InputError(out, "", f"lies in {above.name} of the data set {above.parent}", "a name outside the data set")
    restore(place)
    if place.suffix.lower() in DOCUMENTS and not os.path.isdir(place):
        wrong = f"ends with '{place.suffix}', and a run is a folder"
        raise InputError(out, "", wrong, "a folder's name; its page for a browser is report.html in it")
    if os.path.lexists(place):
        earlier = command_of(place)
        alike = next(commands for commands in ALIKE if command in commands)
        if earlier is None:
            raise InputError(out, "", "is in the way and is not a run", "a new name, or an earlier RUN to replace")
        if earlier not in alike:
            expected = f"a new name, or an earlier RUN of {' or '.join(alike)} to replace"
            raise InputError(out, "", f"is in the way and is a run of {earlier}", expected)
        refuse_foreign(place, FILES, "a run")
    if printable(str(place), layout=False) != str(place):  # what writes for TensorBoard takes names of UTF-8 only
        raise InputError(out, "", "is not a name that can be printed", "a folder's name without control characters")


def command_of(path: Path) -> str | None:
    """Command that wrote the run in the folder `path`, of whatever format; None where `path` is no run."""
    if path.is_symlink():
        return None
    try:
        head = msgspec.json.decode(read_file(path / "report.json", "a report", LARGEST))
    except (ValueError, RecursionError):
        return None
    if not isinstance(head, dict) or not {"format", "rotorid"} <= head.keys():
        return None
    return str(head.get("command"))
