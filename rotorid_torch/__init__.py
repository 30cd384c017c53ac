"""rotorid: identification of rotorcraft models from flight data."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rotorid_torch.data.dataset import Dataset as Dataset
    from rotorid_torch.data.dataset import load as load
    from rotorid_torch.data.flight import Flight as Flight
    from rotorid_torch.effects.base import Effect as Effect
    from rotorid_torch.effects.registry import register as register
    from rotorid_torch.errors import InputError as InputError
    from rotorid_torch.identification.estimate.output_error import output_error as output_error
    from rotorid_torch.identification.filter_error.method import filter_error as filter_error
    from rotorid_torch.identification.reconstruct.reconstruction import reconstruct as reconstruct
    from rotorid_torch.identification.reconstruct.unscented_filter import unscented_filter as unscented_filter
    from rotorid_torch.identification.regress.ftr import regress as regress
    from rotorid_torch.importing.logs import import_logs as import_logs
    from rotorid_torch.model.model import Model as Model
    from rotorid_torch.run.check import check as check
    from rotorid_torch.run.close_loop import Loop as Loop
    from rotorid_torch.run.close_loop import close_loop as close_loop
    from rotorid_torch.run.pipeline import identify as identify
    from rotorid_torch.run.result import Run as Run

_PUBLIC = {
    "Dataset": "data.dataset",
    "load": "data.dataset",
    "Flight": "data.flight",
    "Effect": "effects.base",
    "register": "effects.registry",
    "InputError": "errors",
    "regress": "identification.regress.ftr",
    "output_error": "identification.estimate.output_error",
    "filter_error": "identification.filter_error.method",
    "reconstruct": "identification.reconstruct.reconstruction",
    "unscented_filter": "identification.reconstruct.unscented_filter",
    "import_logs": "importing.logs",
    "Model": "model.model",
    "check": "run.check",
    "Loop": "run.close_loop",
    "close_loop": "run.close_loop",
    "Run": "run.pipeline",
    "identify": "run.pipeline",
}
__all__ = [*_PUBLIC]


def __getattr__(name: str) -> Any:
    # loaded when first used: `rotorid --help` needs no torch
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"rotorid_torch.{_PUBLIC[name]}"), name)
