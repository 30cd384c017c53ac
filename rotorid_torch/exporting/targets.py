"""Every target by its option, and how several are written at once: each file is whole or absent."""

import warnings
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.core.storage.atomic import atomic_file, refuse_unless_writable
from rotorid_torch.errors import InputError
from rotorid_torch.exporting.c_source import c_source
from rotorid_torch.exporting.description import Fmi
from rotorid_torch.exporting.fmu import write_fmu
from rotorid_torch.exporting.onnx_graph import write_onnx
from rotorid_torch.exporting.parameter_table import write_table
from rotorid_torch.exporting.state_space import FORMS, write_state_space
from rotorid_torch.exporting.subject import Subject

FILES: Mapping[str, Callable[[Subject, Path], None]] = {
    "fmu": write_fmu,
    "statespace": write_state_space,
    "onnx": write_onnx,
    "csv": write_table,
}
ENDINGS: Mapping[str, tuple[str, ...]] = {"fmu": (".fmu",), "statespace": FORMS, "onnx": (".onnx",), "csv": (".csv",)}
TARGETS = (*FILES, "c")
"""Names of all targets; "c" is a folder."""


def export(
    subject: Subject, places: Mapping[str, str | Path], fmi: str = Fmi.TWO.value, overwrite: bool = False
) -> dict[str, Path]:
    """Write a model for other tools; what was written, by target.

    Parameters
    ----------
    places : by target (`TARGETS`) the file, or for "c" the folder. fmi : version of the FMU, "2.0" or "3.0".
    overwrite : replace files that are in the way.

    Raises
    ------
    InputError : no target or an unknown one, a place that is taken or has another ending, a package or a compiler that
        is not installed, or a model that has no such form.
    """
    if not places:
        raise InputError("export", "", "names no target", f"at least one of {', '.join(f'--{t}' for t in TARGETS)}")
    unknown = next((t for t in places if t not in TARGETS), None)
    if unknown is not None:
        raise InputError("export", unknown, "is no target", ", ".join(TARGETS))
    if fmi not in [v.value for v in Fmi]:
        raise InputError("export", "--fmi", f"is '{fmi}'", " or ".join(v.value for v in Fmi))
    arguments.flag(Argument("export", "overwrite"), overwrite)
    wanted = {t: arguments.place(Argument("export", t), place).absolute() for t, place in places.items()}
    for target, place in wanted.items():
        _refuse(target, place, overwrite)
    subject = subject.driven()
    if subject.doubt:
        warnings.warn(subject.doubt, stacklevel=4)
    for target, place in wanted.items():
        if target == "c":
            c_source(subject.model, subject.title, subject.step).write(place)
            continue
        write = partial(write_fmu, fmi=Fmi(fmi)) if target == "fmu" else FILES[target]
        with atomic_file(place) as file:
            _write(write, subject, file, place)
    return wanted


def _write(write: Callable[[Subject, Path], None], subject: Subject, file: Path, place: Path) -> None:
    """Into a file of another name, which has the ending that the writer goes by."""
    ended = file.with_name(file.name + place.suffix)
    try:
        write(subject, ended)
        ended.replace(file)
    except InputError as error:
        where = place if error.file == str(ended) else error.file
        raise InputError(where, error.key, error.wrong, error.expected) from error
    finally:
        ended.unlink(missing_ok=True)


def _refuse(target: str, place: Path, overwrite: bool) -> None:
    endings = ENDINGS.get(target)
    if endings and place.suffix not in endings:
        wrong = f"ends with '{place.suffix}'" if place.suffix else "has no ending"
        raise InputError(place, f"--{target}", wrong, " or ".join(endings))
    if target == "c":
        if place.exists() and not place.is_dir():
            raise InputError(place, "--c", "is a file", "a folder")
        if place.is_dir() and any(place.iterdir()) and not overwrite:
            raise InputError(place, "--c", "is not empty", "a new folder, or --overwrite")
    elif place.is_dir():
        raise InputError(place, f"--{target}", "is a folder", "the name of a file")
    elif place.exists() and not overwrite:
        raise InputError(place, f"--{target}", "is in the way", "a new name, or --overwrite")
    refuse_unless_writable(place)
