"""model.pt: the spec and the numbers of a model, and nothing that runs code when it is read."""

import io
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from rotorid_torch.core.storage.files import read_file
from rotorid_torch.core.storage.memory import bounded_memory
from rotorid_torch.effects.spec import ModelSpec, read_spec
from rotorid_torch.errors import InputError
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build

FORMAT = 1
"""Version of the file; another one is refused."""
LARGEST = 64 * 2**20
"""Bytes of a model.pt, packed and unpacked, at most; a network of the largest kind takes less than a hundredth."""
MEMORY = 2**30
"""What reading one may take."""
EXPECTED = "a model.pt written by rotorid identify"
AGAIN = f"{EXPECTED} of this version; identify again"
SAME = 1e-6
"""Relative difference of what follows from the spec, and is written beside it, on another machine."""


def save(model: Model, spec: ModelSpec, path: Path) -> None:
    """Write a model that `build(spec)` made, with its parameters."""
    buffer = io.BytesIO()  # torch itself does not say why it could not write
    torch.save({"format": FORMAT, "spec": spec.plain(), "state": model.state_dict()}, buffer)
    path.write_bytes(buffer.getbuffer())


def load(path: str | Path) -> tuple[Model, ModelSpec]:
    """Read model.pt.

    Raises
    ------
    InputError : the file is not there, is not a model of this format, holds numbers that no vehicle has or parts that
        do not fit each other, or names an effect that does not exist.
    """
    held = _held(path, read_file(path, EXPECTED, LARGEST))
    if not isinstance(held, Mapping) or {*held} != {"format", "spec", "state"}:
        raise InputError(path, "", "is not a model: it has not exactly format, spec and state", EXPECTED)
    if held["format"] != FORMAT:
        raise InputError(path, "format", f"is {str(held['format'])[:20]}", f"{FORMAT}")
    spec = read_spec(held["spec"], path)
    try:
        model = build(spec)
    except InputError as error:
        raise InputError(path, f"spec: {error.key}", error.wrong, error.expected) from None
    except Exception as error:  # a spec of the right form may still lack what one of its parts needs
        raise InputError(path, "spec", f"does not fit together ({_short(error)})", EXPECTED) from None
    _take(model, held["state"], path)
    return model, spec


def _held(path: str | Path, content: bytes) -> Any:
    """What the file holds: plain data and tensors; its sizes are judged before anything is unpacked."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            unpacked = sum(member.file_size for member in archive.infolist())
    except Exception:  # a damaged archive fails in many ways
        raise InputError(path, "", "is not a model: no whole archive as torch writes it", EXPECTED) from None
    if unpacked > LARGEST:
        raise InputError(path, "", f"unpacks to {unpacked} bytes", f"{EXPECTED}, of at most {LARGEST} bytes")
    try:
        with warnings.catch_warnings(), bounded_memory(MEMORY):
            warnings.simplefilter("ignore")  # what torch remarks on a foreign file, the refusal says better
            return torch.load(io.BytesIO(content), weights_only=True, map_location="cpu")
    except Exception:  # torch fails in many ways, and its words advise to trust the file
        text = "is not a model: it is damaged, or holds more than numbers, names and tensors"
        raise InputError(path, "", text, EXPECTED) from None


def _take(model: Model, state: Any, path: str | Path) -> None:
    """Give the model its numbers; what follows from the spec has to be the same."""
    built = model.state_dict()
    if not isinstance(state, Mapping) or {*state} != {*built}:
        odd = sorted({str(name) for name in {*built} ^ {*(state if isinstance(state, Mapping) else ())}})
        raise InputError(path, "state", f"does not belong to the spec ({', '.join(odd[:3])})", AGAIN)
    theta = state["theta"]
    if isinstance(theta, Tensor) and theta.ndim == 1 and len(theta) != len(built["theta"]):
        text = f"has the shape {(len(theta),)}, not {(len(built['theta']),)}: an earlier version wrote the file"
        raise InputError(path, "state: theta", text, AGAIN)
    for name, expected in built.items():
        wrong = _difference(name, state[name], expected)
        if wrong:
            raise InputError(path, f"state: {name}", wrong, f"{EXPECTED}, unchanged")
    theta = state["theta"].detach()
    outside = (model.parameter_set.clamp(theta) != theta).nonzero().flatten().tolist()
    if outside:
        parameter = model.parameter_set.parameters[outside[0]]
        low, high = parameter.bounds
        text = f"is {float(theta[outside[0]]):g}"
        raise InputError(path, f"state: {parameter.name}", text, f"{low:g} to {high:g} {parameter.unit}".strip())
    model.load_state_dict(dict(state))


def _difference(name: str, value: Any, expected: Tensor) -> str:
    """What is wrong with a tensor that stands for this one; empty where nothing is."""
    if not isinstance(value, Tensor) or value.layout != torch.strided or value.dtype != expected.dtype:
        return f"is no tensor of {str(expected.dtype).removeprefix('torch.')}"
    if value.shape != expected.shape:
        return f"has the shape {tuple(value.shape)}, not {tuple(expected.shape)}"
    if not bool(value.isfinite().all()):
        return "holds numbers that are not finite"
    slack = SAME * float(expected.abs().max()) if expected.numel() else 0.0
    if name != "theta" and not torch.allclose(value, expected, rtol=SAME, atol=slack):
        return "is not what follows from the spec"
    return ""


def _short(error: Exception) -> str:
    text = f"{type(error).__name__} {error}" if isinstance(error, LookupError) else str(error)
    return text.partition("\n")[0][:120]
