"""model.pt: the spec and the numbers of a model, and nothing that runs code when it is read."""

from __future__ import annotations

import pickle
from pathlib import Path

import msgspec
import torch

from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.errors import InputError
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build

FORMAT = 1


def save(model: Model, spec: ModelSpec, path: Path) -> None:
    """Write a model that `build(spec)` made, with its parameters."""
    torch.save({"format": FORMAT, "spec": spec.plain(), "state": model.state_dict()}, path)


def load(path: str | Path) -> tuple[Model, ModelSpec]:
    """Read model.pt.

    Raises
    ------
    InputError : the file is not there, is not a model of this format, or names an effect that does not exist.
    """
    expected = "a model.pt written by rotorid identify"
    try:
        held = torch.load(path, weights_only=True)
        if not isinstance(held, dict) or held.get("format") != FORMAT:
            raise InputError(path, "format", "not a model of this format", expected)
        spec = ModelSpec.from_plain(held["spec"])
        model = build(spec)
        model.load_state_dict(held["state"])
    except OSError as e:
        raise InputError(path, "", e.strerror or "cannot be read", expected) from e
    except (pickle.UnpicklingError, msgspec.ValidationError, RuntimeError, KeyError, EOFError) as e:
        raise InputError(path, "", f"not a model: {str(e).splitlines()[0]}", expected) from e
    return model, spec
