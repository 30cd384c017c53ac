"""model.pt: the spec and the numbers of a model, and nothing that runs code when it is read."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

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
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what torch remarks on a foreign file, the refusal says better
            return _model(torch.load(path, weights_only=True))
    except OSError as e:
        raise InputError(path, "", e.strerror or "cannot be read", expected) from e
    except InputError as e:
        raise InputError(path, e.key, e.wrong, e.expected) from e
    except Exception as e:  # a damaged or foreign file may fail anywhere in pickle, torch, msgspec or build
        said = str(e).splitlines() or ["the file is empty"]
        raise InputError(path, "", f"not a model: {said[0]}", expected) from e


def _model(held: Any) -> tuple[Model, ModelSpec]:
    if not isinstance(held, dict) or held.get("format") != FORMAT:
        raise ValueError(f"it has no format {FORMAT}")
    spec = ModelSpec.from_plain(held["spec"])
    model = build(spec)
    model.load_state_dict(held["state"])
    theta = model.theta.detach()
    if not torch.equal(model.parameter_set.clamp(theta), theta):  # a NaN equals nothing
        raise ValueError("its parameters leave their bounds")
    return model, spec
