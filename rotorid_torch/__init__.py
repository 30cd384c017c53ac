"""rotorid: identification of rotorcraft models from flight data.

    data = rotorid.load("DATASET")                        a data set; Dataset.from_arrays makes one of arrays
    rotorid.import_log(["flight.ulg"], "DATASET")         a data set of logs
    rotorid.check(data)                                   can a model be identified from these flights, and of what
    run = rotorid.identify(data)                          a model, with errors and scores; print(run), run["M.q"]
    loop = rotorid.close_loop(data)                       what the model lacks by name; loop.verdict, loop.effects
    rotorid.open_run("RUN")                               a run that was written, with its model; run.page is its report
    rotorid.simulate(run, data["doublet"], seconds=8.0)   a free run of the model on a flight
    run.export(fmu="model.fmu")                           the model for other tools; rotorid.export(run, ...) too
    rotorid.fly("DATASET", seed=1)                        flights of the built-in aircraft

The steps alone, on anybody's model:

    rotorid.regress(response, regressors, dt, band=(0.1, 2.0))
    rotorid.unscented_filter(f, h, x0, P0, Q, R, controls, outputs, dt)
    rotorid.output_error(model, flights, free=["Mq"])
    rotorid.filter_error(model, flights, free=["Mq"], process_noise="diagonal")

Chapters, each of which imports only those before it: `core` (numerics, native code), `data` and `effects` (what is
measured, and what physics there is), `consistency` (sensors and clocks), `model`, then `importing`, `simulation`
(aircraft with equations of their own) and `identification` (the three steps), `validate`, `trace` (which effects a
model lacks) and `report`, `exporting` and `learning`, and `run`, which knows the order of the steps. Every folder's
`__init__` says where to begin.

Physics of one's own is a subclass of `Effect` with its `Parameter`s and `State`s; `rotorid.register` adds it to the
library, `rotorid.effects.registry.registered()` is the library by id.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rotorid_torch.version import __version__ as __version__

if TYPE_CHECKING:
    from rotorid_torch import effects as effects
    from rotorid_torch.core.parameters import Parameter as Parameter
    from rotorid_torch.core.state import State as State
    from rotorid_torch.data.dataset import Dataset as Dataset
    from rotorid_torch.data.dataset import load as load
    from rotorid_torch.data.flight import Flight as Flight
    from rotorid_torch.effects.base import Effect as Effect
    from rotorid_torch.effects.base import Frame as Frame
    from rotorid_torch.effects.base import Role as Role
    from rotorid_torch.effects.base import Stage as Stage
    from rotorid_torch.effects.registry import register as register
    from rotorid_torch.errors import InputError as InputError
    from rotorid_torch.errors import OutsideRange as OutsideRange
    from rotorid_torch.errors import WrappedAngle as WrappedAngle
    from rotorid_torch.identification.estimate.output_error import output_error as output_error
    from rotorid_torch.identification.filter_error.method import filter_error as filter_error
    from rotorid_torch.identification.reconstruct.reconstruction import reconstruct as reconstruct
    from rotorid_torch.identification.reconstruct.unscented_filter import unscented_filter as unscented_filter
    from rotorid_torch.identification.regress.ftr import regress as regress
    from rotorid_torch.importing.logs import import_log as import_log
    from rotorid_torch.model.model import Model as Model
    from rotorid_torch.run.check import check as check
    from rotorid_torch.run.close_loop import Loop as Loop
    from rotorid_torch.run.close_loop import close_loop as close_loop
    from rotorid_torch.run.output.monitor import Monitor as Monitor
    from rotorid_torch.run.pipeline import identify as identify
    from rotorid_torch.run.result import Run as Run
    from rotorid_torch.run.saved_model import export as export
    from rotorid_torch.run.saved_model import open_run as open_run
    from rotorid_torch.run.saved_model import simulate as simulate
    from rotorid_torch.simulation.flight_test import fly as fly


_PUBLIC = {
    "Dataset": "data.dataset",
    "load": "data.dataset",
    "Flight": "data.flight",
    "Effect": "effects.base",
    "Frame": "effects.base",
    "Parameter": "core.parameters",
    "Role": "effects.base",
    "Stage": "effects.base",
    "State": "core.state",
    "register": "effects.registry",
    "InputError": "errors",
    "OutsideRange": "errors",
    "WrappedAngle": "errors",
    "Monitor": "run.output.monitor",
    "regress": "identification.regress.ftr",
    "output_error": "identification.estimate.output_error",
    "filter_error": "identification.filter_error.method",
    "reconstruct": "identification.reconstruct.reconstruction",
    "unscented_filter": "identification.reconstruct.unscented_filter",
    "import_log": "importing.logs",
    "Model": "model.model",
    "check": "run.check",
    "Loop": "run.close_loop",
    "close_loop": "run.close_loop",
    "Run": "run.result",
    "identify": "run.pipeline",
    "export": "run.saved_model",
    "open_run": "run.saved_model",
    "simulate": "run.saved_model",
    "fly": "simulation.flight_test",
}
"""Public names and their modules."""
__all__ = [*_PUBLIC, "effects"]


def __getattr__(name: str) -> Any:
    # loaded when first used: `rotorid --help` needs no torch
    if name == "effects":
        return import_module("rotorid_torch.effects")
    if name not in _PUBLIC:
        from rotorid_torch.errors import nearest

        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{nearest(name, __all__)}")
    return getattr(import_module(f"rotorid_torch.{_PUBLIC[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
