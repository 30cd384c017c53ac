"""The two defined problems: the product and the anchors side by side, in time and in figures."""

from __future__ import annotations

import importlib.util
import math
import os
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import torch

from benchmark.clock import interleaved, profile
from benchmark.rows import Figure, NotMeasured
from benchmark.setting import Measured, Setting
from benchmark.torch_modules import DerivativeModel, LoadedBody, numbers
from rotorid_torch.core.native.filtering import Weights
from rotorid_torch.identification.estimate.engine import engine_for
from rotorid_torch.identification.estimate.likelihood import Likelihood
from rotorid_torch.identification.estimate.residuals import Noise
from rotorid_torch.identification.estimate.segments import Records, cut
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.identification.reconstruct.sigma_points import ProcessNoise
from rotorid_torch.identification.reconstruct.unscented_filter import Engine, SampledSystem, filter_and_smooth

Program = Callable[[], dict[str, Any]]
"""Solves a problem and returns what the anchors return, as numpy arrays."""
RACES = {"": ("product", "cpp"), "-threads": ("product2", "cpp2"), "-jax": ("product", "jax")}
"""Ending of a row's name: the product and whom it is held against."""
NAMES = {"cpp": "C++", "cpp2": "C++, two threads", "jax": "JAX by hand"}
QUICK_SAMPLES = 300
MANY = 100
"""Flights of which fewer repeats are enough."""


class Anchors:
    """Independent programs for the problems, from a folder with harness.py, problems.py and peers_*.py.

    Raises
    ------
    NotMeasured : there is none.
    """

    def __init__(self, folder: Path | None) -> None:
        if folder is None:
            raise NotMeasured("no anchors (--anchors DIR)")
        if not (folder / "harness.py").is_file():
            raise NotMeasured(f"no harness.py in {folder}")
        self.harness = _loaded(folder / "harness.py")
        self.harness.malloc()  # what a timed program frees is kept for its next call, for all alike
        self.problems: ModuleType = self.harness.pb

    def data(self, problem: str, flights: int, quick: bool) -> dict[str, Any]:
        """The problem's records."""
        make = self.problems.a_data if problem == "A" else self.problems.b_data
        return make(flights, n=QUICK_SAMPLES if quick else self.problems.N)

    def peer(self, problem: str, name: str, data: dict[str, Any]) -> Program:
        """One of the anchors, called once; NotMeasured where it is not installed."""
        try:
            program = self.harness.make(self.harness.PEERS[problem][name], data)
            program()
        except ImportError as error:
            raise NotMeasured(f"{error.name or error} is not installed") from error
        except (OSError, RuntimeError) as error:
            raise NotMeasured(f"{name} fails: {str(error).splitlines()[0]}") from error
        return program

    def error(self, problem: str, got: dict[str, Any], against: dict[str, Any]) -> float:
        """Largest relative difference, as the problem defines it."""
        return (self.problems.a_error if problem == "A" else self.problems.b_error)(got, against)


def _loaded(file: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("bench_anchors", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def filtering(problems: Any, data: dict[str, Any], threads: int = 1, engine: Engine = "native") -> Program:
    """Problem A by the filter that `reconstruct` calls; the model is traced anew at every call, as there."""
    model, y = LoadedBody(problems), numbers(data["y"])
    prior, R = (numbers(data["x0"]), numbers(data["P0"])), torch.diag(numbers(problems.SD_Y) ** 2)
    noise = ProcessNoise.constant(torch.diag(numbers(problems.SD_Q) ** 2))
    alpha, size = problems.ALPHA, problems.ALPHA**2 * (problems.NX + problems.KAPPA)
    weights = Weights(math.sqrt(size), 1.0 - problems.NX / size + 1.0 - alpha**2 + problems.BETA, 0.5 / size)
    controls = y.new_zeros(*y.shape[:2], 0)

    def program() -> dict[str, Any]:
        with torch.no_grad():
            system = SampledSystem(model, model.output, prior, noise, R, controls, y, problems.DT)
            got = on_threads(threads, lambda: filter_and_smooth(system, smooth=False, weights=weights, engine=engine))
        return {"x": got.means.numpy(), "P": got.covariances.numpy(), "ll": got.log_likelihood.numpy()}

    return program


def on_threads(threads: int, program: Callable[[], Any]) -> Any:
    """With so many threads in native loops; torch keeps one."""
    before = os.environ.get("ROTORID_THREADS")
    os.environ["ROTORID_THREADS"] = str(threads)
    try:
        return program()
    finally:
        del os.environ["ROTORID_THREADS"]
        if before is not None:
            os.environ["ROTORID_THREADS"] = before


def normal_equations(problems: Any, data: dict[str, Any], threads: int = 1, engine: Engine = "native") -> Program:
    """Problem B by the likelihood that `identify` minimises: one evaluation and its linear model."""
    system = System(DerivativeModel(problems, data["p"]))
    controls, y, x0 = (numbers(data[name]) for name in ("c", "y", "x0"))
    flights, samples, count = len(y), y.shape[1], len(system.theta)
    records = Records(
        dt=problems.DT,
        lengths=torch.full((flights,), samples),
        start=torch.zeros(flights, dtype=torch.float64),
        controls=controls,
        outputs=y,
        states=torch.cat([x0[:, None], torch.full_like(y[:, 1:], math.nan)], dim=1),
    )
    sd = numbers(problems.SD_B)
    problem = Likelihood(
        system=system,
        engine=engine_for(system, records, "rk4", engine),
        records=records,
        segments=cut(records, samples),
        states=records.states,
        noise=Noise("held", sd, torch.diag(sd**2)),
        x0=x0,
        x0_mean=x0,
        x0_sd=None,
        prior_mean=system.theta,
        prior_sd=torch.full((count,), math.inf, dtype=torch.float64),
    )

    def solve() -> dict[str, Any]:
        place = problem.evaluate(system.theta)
        A, b, _ = problem.linearise(place)
        return {"cost": place.cost, "g": (A.mT @ b).numpy(), "H": (A.mT @ A).numpy()}

    return lambda: on_threads(threads, solve)


PRODUCT: dict[str, Callable[..., Program]] = {"A": filtering, "B": normal_equations}


def race(setting: Setting, problem: str, flights: int) -> Measured:
    """One problem by the product and by those anchors that are installed, in turn."""
    anchors = Anchors(setting.anchors)
    wanted = {f"{problem}-{flights}{end}": pair for end, pair in RACES.items()}
    wanted = {name: pair for name, pair in wanted.items() if name in setting.wanted}
    data, programs, missing = anchors.data(problem, flights, setting.quick), {}, {}
    for name in dict.fromkeys(name for pair in wanted.values() for name in pair):
        try:
            programs[name] = _entrant(anchors, problem, name, data)
        except NotMeasured as reason:
            missing[name] = str(reason)
    seconds = interleaved(programs, min(setting.repeats, 5) if flights >= MANY else setting.repeats)
    if setting.profile and "product" in programs:
        setting.tell(profile(f"{problem}, {flights} flights, one thread", programs["product"]))
    return {row: _compared(seconds, *pair, missing) for row, pair in wanted.items()}


def _entrant(anchors: Anchors, problem: str, name: str, data: dict[str, Any]) -> Program:
    """Ready to be timed: called once."""
    if not name.startswith("product"):
        return anchors.peer(problem, name, data)
    program = PRODUCT[problem](anchors.problems, data, threads=2 if name == "product2" else 1)
    program()
    return program


def _compared(seconds: dict[str, float], product: str, other: str, missing: dict[str, str]) -> Figure | str:
    if other in missing:
        return f"not measured: {missing[other]}"
    ours, theirs = 1e3 * seconds[product], 1e3 * seconds[other]
    return Figure(ours, "ms", f"{NAMES[other]}, {theirs:.3g} ms", ours / theirs)


def agreement(setting: Setting, problem: str) -> Measured:
    """Differences to C++ and to the reference engine, on two flights."""
    anchors = Anchors(setting.anchors)
    data, found = anchors.data(problem, 2, setting.quick), {}
    make = PRODUCT[problem]
    got = make(anchors.problems, data)()
    if f"accuracy-{problem}-cpp" in setting.wanted:
        difference = anchors.error(problem, got, anchors.peer(problem, "cpp", data)())
        found[f"accuracy-{problem}-cpp"] = Figure(difference, "relative", "C++")
    if f"accuracy-{problem}" in setting.wanted:
        difference = anchors.error(problem, got, make(anchors.problems, data, engine="reference")())
        found[f"accuracy-{problem}"] = Figure(difference, "relative", "reference engine")
    return found
