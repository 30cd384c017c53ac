"""An identified model with all that is said of it, and its way into a folder and back."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from shutil import copytree
from typing import TYPE_CHECKING

import numpy as np

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.core.names import VELOCITIES
from rotorid_torch.core.parameters import ParameterTable
from rotorid_torch.core.storage.atomic import restore
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.errors import InputError
from rotorid_torch.exporting.subject import Subject
from rotorid_torch.exporting.targets import export
from rotorid_torch.identification.model_estimation import ModelEstimate
from rotorid_torch.identification.model_regression import ModelRegression
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction
from rotorid_torch.model.model import Model
from rotorid_torch.model.modes import control_matrix, state_matrix
from rotorid_torch.model.own_effects import extended
from rotorid_torch.model.save import load as load_model
from rotorid_torch.model.save import save as save_model
from rotorid_torch.report.page.document import Shown
from rotorid_torch.report.page.facts import ModelFacts
from rotorid_torch.report.records import EffectRecord, FitRecord, ParameterRecord, Report, VerdictRecord, read_report
from rotorid_torch.report.short_horizon import explained, short_horizon
from rotorid_torch.report.words.verdict import opening
from rotorid_torch.run.output.folder import run_folder
from rotorid_torch.run.output.monitor import Monitor
from rotorid_torch.run.output.write import write_report

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rotorid_torch.report.overlay import Overlay


class Result(ParameterTable, ABC):
    """What a run says, whether it was made just now or read from its folder."""

    model: Model
    spec: ModelSpec
    fit: FitRecord
    record: Report

    def __getitem__(self, name: str) -> ParameterRecord:
        """The derivative of this name with the rotor settled ("L.p"), else the parameter of the name or its last parts.

        "forces.L.p" is the parameter, which holds flapping and inflow still. Raises KeyError: there is none.
        """
        return next((d for d in self.fit.derivatives if d.name == name), None) or super().__getitem__(name)

    @abstractmethod
    def report(self, path: str | Path) -> Path:
        """Write the RUN (report, pictures, model, reconstruction) to a folder; InputError where it is not free."""

    @staticmethod
    def load(path: str | Path) -> Result:
        """A run from its folder, as `rotorid.open_run`; InputError where there is none."""
        place = arguments.place(Argument("Run.load", "path"), path)
        restore(place)
        return SavedRun(place, read_report(place))

    @property
    @abstractmethod
    def step(self) -> float:
        """Sample interval of the flights, s."""

    def export(
        self, *, model: Model | None = None, fmi: str = "2.0", overwrite: bool = False, **places: str | Path
    ) -> dict[str, Path]:
        """Write the model for other tools: fmu=, statespace= (.json or .mat), onnx=, csv= a file, c= a folder.

        Parameters
        ----------
        model : one of `with_effects` that was trained in torch, in place of the run's; it has no standard errors.
        fmi : version of the FMU, "2.0" or "3.0". overwrite : replace what is in the way.

        Raises
        ------
        InputError : a place is taken, a compiler or package is missing, or the model has no such form.

        Warns where a moment of a multirotor is held at zero. A voltage that nothing reads is no input.
        """
        tool, name = f"rotorid {self.record.rotorid}", self.record.dataset.name
        subject = Subject(self.model, self.spec, name, self.step, tool, self.parameters)
        if model is not None:
            subject = replace(subject, model=model, spec=self._spec_of(model), parameters=())
        return export(subject, places, fmi, overwrite)

    def _spec_of(self, model: Model) -> ModelSpec:
        """The structure of a model that is the run's own, with or without more effects."""
        of = Argument("export", "model")
        arguments.instance(of, model, Model, 'a Model: run.with_effects("...")')
        if model.body != self.model.body or any(model.effect(e.id) is None for e in self.model.chain):
            raise of.wrong("is of another run", 'run.with_effects("...") of this one')
        return self.spec.with_effects(*(e.id for e in model.chain if self.model.effect(e.id) is None))

    def with_effects(self, *effects: str) -> Model:
        """The model with more effects by id, started at its numbers: to train in torch.

        Raises
        ------
        InputError : an effect that there is not, or one of a user that breaks what it promises.
        """
        return extended(self.model, self.spec, effects)

    @property
    def title(self) -> str:
        """The command, the data set and how well the model describes it."""
        short = short_horizon(self.fit)
        scores = "J " + ", ".join(f"{n} {J:.3g}" for n, J in self.scores.items() if J is not None)
        summary = explained(short[-1]).removesuffix(".") if short else scores
        verdict = "" if self.record.verdict is None else f". {opening(self.record)}"
        return f"{self.record.command} {self.record.dataset.name}: {summary}{verdict}"

    @property
    def scores(self) -> dict[str, float | None]:
        """J over the lists of flights: identify, validate, acid; those of a multirotor drift, `title` judges it."""
        totals = self.fit.scores
        return {"identify": totals.identify, "validate": totals.validate, "acid": totals.acid}

    @property
    def parameters(self) -> tuple[ParameterRecord, ...]:
        """Every parameter with its standard error, unit, bounds and status."""
        return self.fit.parameters

    @property
    def before(self) -> FitRecord | None:
        """The nominal model's parameters, modes and scores."""
        return self.record.before

    @property
    def after(self) -> FitRecord | None:
        """Those with what was traced and added; None where nothing was."""
        return self.record.after

    @property
    def verdict(self) -> VerdictRecord | None:
        """The one statement about undeclared effects; None where none were looked for."""
        return self.record.verdict

    @property
    def effects(self) -> tuple[EffectRecord, ...]:
        """What was found about every effect."""
        return self.record.effects


@dataclass(frozen=True, eq=False, repr=False)
class Run(Result):
    """An identified model with everything that is known about it.

    model : the fitted module. fit : parameters, modes and scores. warnings : sentences for people. of_flights : those
    on the flights alone.
    """

    model: Model
    spec: ModelSpec
    fit: FitRecord
    record: Report
    reconstruction: Reconstruction
    regressions: ModelRegression
    estimate: ModelEstimate
    overlays: tuple[Overlay, ...] = field(repr=False)
    of_flights: tuple[str, ...] = ()
    earlier: tuple[Overlay, ...] = field(default=(), repr=False)  # of a loop: before effects were added

    @property
    def step(self) -> float:
        """Sample interval of the flights, s."""
        time = self.reconstruction.arrays(next(iter(self.reconstruction.flights)))["time"]
        return float(time[1] - time[0])

    def plot(self) -> dict[str, Figure]:
        """The report's pictures as matplotlib figures, by name."""
        from rotorid_torch.report.loop_figures import draw_run  # slow to import

        return draw_run(self.record, self.earlier, self.overlays)

    def report(self, path: str | Path) -> Path:
        """Write the RUN (report, pictures, model, reconstruction) to a folder; InputError where it is not free."""
        place = arguments.place(Argument("report", "path"), path)
        with run_folder(place, self.record.command) as folder:
            self.write(folder)
        return place

    def write(self, folder: Path, monitor: Monitor | None = None) -> None:
        """Write everything but log and TensorBoard records into an open run folder."""
        write_model(self, folder)
        write_report(folder, self.record, Shown(self.overlays, self.earlier, facts_of(self.model)), monitor)


@dataclass(frozen=True, eq=False, repr=False)
class SavedRun(Result):
    """A run read from its folder: what the report says, and the model."""

    path: Path
    record: Report

    @cached_property
    def _loaded(self) -> tuple[Model, ModelSpec]:
        return load_model(self.path / "model.pt")

    @property
    def model(self) -> Model:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The fitted module."""
        return self._loaded[0]

    @property
    def spec(self) -> ModelSpec:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Structure of the model."""
        return self._loaded[1]

    @property
    def step(self) -> float:
        """Sample interval of the flights that were reconstructed, s."""
        files = sorted((self.path / "reconstruct").glob("*.npz"))
        if not files:
            raise InputError(self.path / "reconstruct", "", "holds no flight", "a whole run")
        with np.load(files[0]) as arrays:
            time = arrays["time"]
        return float((time[-1] - time[0]) / (len(time) - 1))

    def plot(self) -> dict[str, Figure]:
        """The pictures in the run's folder as matplotlib figures, by name."""
        from rotorid_torch.report.figures import shown  # slow to import

        return {path.stem: shown(path) for path in sorted((self.path / "figures").glob("*.png"))}

    @property
    def page(self) -> Path:
        """The report for a browser, `report.html` in the run's folder."""
        return self.path / "report.html"

    def report(self, path: str | Path) -> Path:
        """Write the RUN to another folder; InputError where it is not free."""
        place = arguments.place(Argument("report", "path"), path)
        with run_folder(place, self.record.command) as folder:
            copytree(self.path, folder, dirs_exist_ok=True)
        return place

    @property
    def fit(self) -> FitRecord:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Parameters, modes and scores of the model."""
        fit = self.record.fit
        if fit is None:
            raise InputError(self.path, self.record.command, "has no model", "a run of identify or close-loop")
        return fit


def facts_of(model: Model) -> ModelFacts:
    """What parameters mean, and the model linearised."""
    return ModelFacts(
        {p.name: p.doc for p in model.parameter_set.parameters if p.doc},
        model.layout.names,
        model.body.controls,
        state_matrix(model).tolist(),
        control_matrix(model).tolist(),
    )


def write_model(run: Run, folder: Path) -> None:
    """Reconstruction and model.pt of a run."""
    write_reconstruction(run.reconstruction, folder)
    write_gusts(run.estimate, folder)
    save_model(run.model, run.spec, folder / "model.pt")


def write_gusts(estimate: ModelEstimate, folder: Path) -> None:
    """Smoothed gusts of every identify flight with standard errors, m/s, NAME.npz each; nothing where none were."""
    if estimate.air is None:
        return
    (folder / "gusts").mkdir(exist_ok=True)
    for name, velocity, error in zip(estimate.flights, estimate.air.velocities, estimate.air.errors, strict=True):
        inside = error.any(dim=1)
        columns = {f"gust_{n}": velocity[inside, k].numpy() for k, n in enumerate(VELOCITIES)}
        columns |= {f"gust_{n}_se": error[inside, k].numpy() for k, n in enumerate(VELOCITIES)}
        time = estimate.air.dt * np.arange(int(inside.sum()))
        np.savez(folder / "gusts" / f"{name}.npz", time=time, **columns)  # pyright: ignore[reportArgumentType]


def write_reconstruction(reconstruction: Reconstruction, folder: Path) -> None:
    """Motion and forces of every flight as step 1 found them, NAME.npz each."""
    (folder / "reconstruct").mkdir(exist_ok=True)
    for name in reconstruction.flights:
        np.savez(folder / "reconstruct" / f"{name}.npz", **reconstruction.arrays(name))  # pyright: ignore[reportArgumentType]
