"""What a run has finished, kept beside its place, so that a run that was killed goes on from its last finished step.

While a run to NAME works, `.NAME.checkpoint` holds `key.json` (data set, settings, version) and one file per finished
step, in a form that runs no code when it is read. It goes when the run is whole.
"""

import fcntl
import io
import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from rotorid_torch.core.gauss_newton import Linear, Minimum
from rotorid_torch.core.processes.ranks import Ranks
from rotorid_torch.core.storage.atomic import Unwritable, locked, reason, remove, writing
from rotorid_torch.core.storage.mapped_arrays import give_back
from rotorid_torch.core.storage.paths import absolute, refuse_foreign
from rotorid_torch.core.storage.sealed import Damaged, read_sealed, write_sealed
from rotorid_torch.data.on_demand import OnDemand
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.errors import InputError, say_once
from rotorid_torch.identification.estimate.likelihood import Place
from rotorid_torch.identification.estimate.progressive_fit import Estimate
from rotorid_torch.identification.estimate.residuals import Moments
from rotorid_torch.identification.estimate.uncertainty import Uncertainty
from rotorid_torch.identification.gusts import Air, GustAxis
from rotorid_torch.identification.model_estimation import ModelEstimate
from rotorid_torch.identification.model_regression import ModelRegression
from rotorid_torch.identification.reconstruct.force_noise import ForceNoise
from rotorid_torch.identification.reconstruct.reconstruction import ReconstructedFlight, Reconstruction
from rotorid_torch.identification.regress.ftr import Regression
from rotorid_torch.run.output.folder import refuse_unless_free
from rotorid_torch.run.output.monitor import Monitor

Result = TypeVar("Result")

KINDS = {
    kind.__name__: kind
    for kind in (
        *(ForceNoise, ReconstructedFlight),
        *(Regression, ModelRegression),
        *(Moments, Place, Minimum, Uncertainty, Estimate, GustAxis, Air, ModelEstimate),
    )
}
"""Results that a file may hold, by the name that stands for them in it."""


@dataclass(frozen=True)
class Checkpoint:
    """Files of finished steps; without a folder nothing is kept."""

    folder: Path | None = None

    def read(self, name: str) -> Any:
        """Result of a step; None where it has not been finished, or its file did not reach the disk whole."""
        if self.folder is None:
            return None
        try:
            content = read_sealed(self.folder / f"{name}.pt", name)
        except FileNotFoundError:
            return None
        except (OSError, Damaged) as error:
            why = reason(error) if isinstance(error, OSError) else error
            say_once(f"{self.folder}: the file of a finished step {why}; the step is done once more")
            return None
        return _from_plain(torch.load(io.BytesIO(content), weights_only=True))

    def write(self, name: str, result: object, say: Callable[[str], None]) -> bool:
        """Keep the result of a step; the file is whole or absent. Where it cannot be written, `say` gets a line."""
        if self.folder is None:
            return False
        buffer = io.BytesIO()
        torch.save(_plain(result), buffer)
        try:
            write_sealed(self.folder / f"{name}.pt", name, buffer.getvalue())
        except OSError as error:
            why = f"{self.folder} cannot be written to ({reason(error)})"
            say(f"{why}; a later --resume will repeat what is not kept")
            return False
        return True


@contextmanager
def checkpoint(out: str | Path, key: Mapping[str, str], *, resume: bool, keep: bool) -> Iterator[Checkpoint]:
    """The checkpoint of a run to `out`, new or (with `resume`) that of an interrupted run; removed when the block ends.

    key : what the results depend on, by words for people.
    keep : leave it where the block ends by an exception other than bad input; a kill leaves it in any case.

    Raises InputError: `resume`, and the interrupted run had another key, or a run works there now.
    """
    refuse_unless_free(out, "identify")
    place = absolute(out)
    folder = place.with_name(f".{place.name}.checkpoint")
    with writing(folder), locked(place.parent):
        lock = _taken(folder)
        if lock is not None:
            try:
                _prepare(folder, key, out, resume)
            except BaseException as error:
                if not (resume or isinstance(error, InputError)):
                    remove(folder)
                os.close(lock)
                raise
    if lock is None:
        if resume:
            raise InputError(out, "--resume", "another run is writing there now", "to wait until it has ended")
        yield Checkpoint()
        return
    left = False
    try:
        yield Checkpoint(folder)
    except BaseException as error:
        left = keep and (isinstance(error, Unwritable) or not isinstance(error, InputError))
        raise
    finally:
        if not left:
            remove(folder)
        os.close(lock)


def _taken(folder: Path) -> int | None:
    """The lock of the folder, made where it is missing; None where another process holds it."""
    folder.mkdir(exist_ok=True)
    lock = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        return None
    return lock


def _prepare(folder: Path, key: Mapping[str, str], out: str | Path, resume: bool) -> None:
    """Empty the folder, or with `resume` see that it belongs to the same run; write the key."""
    file = folder / "key.json"
    stored: dict[str, str] = {}
    with suppress(OSError, ValueError):
        stored = json.loads(file.read_text(encoding="utf-8"))
    differing = [word for word in key if stored and stored.get(word) != key[word]]
    if resume and differing:
        word = differing[0]
        wrong = f"the interrupted run has another {word} ({stored.get(word)})"
        raise InputError(out, "--resume", wrong, f"{key[word]}, or no --resume to begin anew")
    if not (resume and stored):
        refuse_foreign(folder, ("key.json", "*.pt", "*.partial"), "an interrupted run")
        for leftover in folder.iterdir():
            leftover.unlink()
        file.write_text(json.dumps(dict(key)), encoding="utf-8")


@dataclass(frozen=True)
class Steps:
    """Does the steps of a run, or takes them from the interrupted one; the first rank reads and writes.

    device, method, why : as `Means` has them. model : what of several models' results have before their names.
    """

    monitor: Monitor
    ranks: Ranks
    results: Checkpoint
    device: str = "cpu"
    method: str = "auto"
    why: str = ""
    model: str = ""

    def do(self, step: str, name: str, make: Callable[[], Result]) -> Result:
        """The result kept under `name`, or made now, timed as `step`, and kept."""
        name = self.model + name
        result = self._stored(step, name)
        if result is None:
            with self.monitor.step(step):
                result = make()
            give_back()
            self.results.write(name, result, self.monitor.tell)
        return result

    def reconstruct(self, names: tuple[str, ...], make: Callable[[], Reconstruction]) -> Reconstruction:
        """The same for step 1 on these flights, which lie in files of their own."""
        whole = f"{self.model}reconstruct"
        stored = self._stored("reconstruct", whole)
        if stored is not None:
            flights = OnDemand[ReconstructedFlight](names, costly=True)
            for name in names:
                flights.keep(name, self.ranks.from_first(self.results.read(f"{whole}-{name}")))
            return Reconstruction(**{**stored, "flights": flights})
        with self.monitor.step("reconstruct"):
            result = make()
            give_back()
            if self.results.folder is not None and all(
                self.results.write(f"{whole}-{name}", result.flights[name], self.monitor.tell) for name in names
            ):
                listed = {**vars(result), "flights": {}}  # it says that all flights are there
                self.results.write(whole, listed, self.monitor.tell)
        return result

    def _stored(self, step: str, name: str) -> Any:
        result = self.ranks.from_first(self.results.read(name))
        if result is not None:
            self.monitor.say(f"{step}: taken from the interrupted run")
        return result


def _plain(value: Any) -> Any:
    """A result as tensors, numbers, words, lists and dicts; a dict of ours is marked by the key "is"."""
    if isinstance(value, Tensor):
        return value.detach().clone()
    if isinstance(value, np.ndarray):
        return {"is": "array", "values": torch.from_numpy(value.copy())}
    if isinstance(value, ModelSpec):
        return {"is": "ModelSpec", "plain": value.plain()}
    if isinstance(value, Linear):
        return {"is": "Linear", "values": [_plain(item) for item in value]}
    if is_dataclass(value):
        return {"is": type(value).__name__, **{f.name: _plain(getattr(value, f.name)) for f in fields(value)}}
    if isinstance(value, Mapping):
        return {"is": "dict", "keys": list(value), "values": [_plain(item) for item in value.values()]}
    if isinstance(value, list | tuple):
        return type(value)(_plain(item) for item in value)
    return value


def _from_plain(plain: Any) -> Any:
    """The result again."""
    if isinstance(plain, list | tuple):
        return type(plain)(_from_plain(item) for item in plain)
    if not isinstance(plain, dict):
        return plain
    kind = plain["is"]
    if kind == "array":
        return plain["values"].numpy()
    if kind == "ModelSpec":
        return ModelSpec.from_plain(plain["plain"])
    if kind == "Linear":
        return Linear(*map(_from_plain, plain["values"]))
    if kind == "dict":
        return dict(zip(plain["keys"], map(_from_plain, plain["values"]), strict=True))
    return KINDS[kind](**{name: _from_plain(item) for name, item in plain.items() if name != "is"})
