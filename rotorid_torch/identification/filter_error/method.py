"""Step 3 where the air moves: the filter error method, maximum likelihood with process noise, on anybody's model."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.errors import InputError
from rotorid_torch.identification import arguments as fit_arguments
from rotorid_torch.identification.estimate.initial_states import smallest_noise
from rotorid_torch.identification.estimate.output_error import (
    Between,
    SearchArguments,
    fitted_in_steps,
    prepared,
    settings_of,
)
from rotorid_torch.identification.estimate.progressive_fit import Monitor
from rotorid_torch.identification.estimate.segments import Records
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.identification.filter_error.extended_kalman import CovarianceForm, FilterProblem, form
from rotorid_torch.identification.filter_error.result import FilterError, result_of, without_gusts
from rotorid_torch.identification.filter_error.search import MaximumSearch


def filter_error(
    model: nn.Module,
    flights: Sequence[Mapping[str, Any]],
    free: Sequence[str] | None = None,
    process_noise: str | Sequence[str] | Tensor = "diagonal",
    noise: str | Tensor = "diagonal",
    x0: str = "free",
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    noise_floor: Sequence[float] | Tensor | None = None,
    max_iterations: int = 100,
    gain: str = "exact",
    engine: str | None = None,
    delays: Mapping[int, float] | None = None,
    angles: Sequence[int] = (),
    monitor: Monitor | None = None,
) -> FilterError:
    """Maximum-likelihood estimate of the free parameters of any module from flights in moving air.

    Output error takes gusts for the vehicle's own motion. Here the states' rates have white noise of unknown size, and
    what is fitted are the innovations of an extended Kalman filter: measured minus predicted from all samples before.

    Parameters
    ----------
    model : module with forward(t, x, u) -> dx/dt and output(x, u) -> y; it is left as it is. Its states are called
        x[0], x[1], ..., or as its attribute `states` (a sequence of words) or its `layout` says.
    flights : dicts of time (T,), controls (T, nu), outputs (T, ny; NaN = missing), x0 (nx,).
    free : names of the parameters to estimate; by default all that ask for gradients. Entries of a tensor are named
        name[i] or name[i,j].
    process_noise : "diagonal" (a size for each state), "full" (correlated), names of the states that have it, or the
        spectral density [nx, nx] to hold (covariance per second). Of zeros it leaves output error.
    noise : of the outputs: "diagonal", "full", or a covariance [ny, ny] to hold.
    x0 : "free" estimates the initial states, from those given; "fixed" believes them.
    bounds : lower and upper bound by name.
    noise_floor : [ny] standard deviation of the sensors, below which no noise is believed.
    gain : "exact", or "held" for models of many states and parameters: the filter's gain is held while parameters move,
        which costs little more than output error. Parameters are a little less certain, as their errors say; errors of
        the noises then believe the parameters.
    max_iterations : of all parts of the search together; 0 leaves the parameters at their start.
    engine : "native" or "reference" (torch, slow); by default native code where the model can be compiled.
    delays, angles : pure delays of controls, outputs that are angles; as in `output_error`.
    monitor : called after each accepted step with iteration, cost, theta.

    Raises
    ------
    InputError
        Where the flights, a name or a matrix do not fit, or the filter diverges from the start.

    Source: Maine and Iliff (1981), SIAM J. Appl. Math. 41; Jategaonkar, Flight Vehicle System Identification, ch. 5.

    Examples
    --------
    A lag x' = a x + b u in gusts, with a = -2 and b = 3:

    >>> import numpy as np
    >>> import torch
    >>> import rotorid_torch as rotorid
    >>> class Lag(torch.nn.Module):
    ...     def __init__(self):
    ...         super().__init__()
    ...         self.a = torch.nn.Parameter(torch.tensor(-1.0))
    ...         self.b = torch.nn.Parameter(torch.tensor(1.0))
    ...
    ...     def forward(self, t, x, u):
    ...         return self.a * x + self.b * u
    ...
    ...     def output(self, x, u):
    ...         return x
    >>> rng, dt = np.random.default_rng(0), 0.02
    >>> time, x = dt * np.arange(1000), np.zeros((1000, 1))
    >>> controls = np.sin(0.1 * time[:, None] ** 2)
    >>> for k in range(999):
    ...     gust = 0.2 * np.sqrt(dt) * rng.standard_normal()
    ...     x[k + 1] = x[k] + dt * (-2.0 * x[k] + 3.0 * controls[k]) + gust
    >>> outputs = x + 0.02 * rng.standard_normal(x.shape)
    >>> flight = {"time": time, "controls": controls, "outputs": outputs, "x0": [0.0]}
    >>> result = rotorid.filter_error(Lag(), [flight])
    >>> abs(result["a"].value + 2.0) < 3.0 * result["a"].se
    True
    >>> print(f"{result.process_noise[0].value:.1f} {result.process_noise[0].unit}")
    0.2 /sqrt(s)
    """
    system, records = prepared(model, flights, free, bounds, Between(delays=delays, angles=angles))
    arguments.word(Argument("arguments", "x0"), x0, ("free", "fixed"))
    arguments.word(Argument("arguments", "engine"), "native" if engine is None else engine, ("native", "reference"))
    arguments.word(Argument("arguments", "gain"), gain, ("exact", "held"))
    fit_arguments.refuse_search(max_iterations, monitor)
    problem = _problem(model, system, records, process_noise, noise)
    fit_arguments.refuse_too_few(records.outputs, len(system.theta), 0 if x0 == "fixed" else records.states.shape[-1])
    floor = _floor(noise_floor, records)
    if x0 == "fixed" and bool(records.states[:, 0].isnan().any()):
        raise InputError("flights", "x0", "absent", 'the initial state of every flight where x0 is "fixed"')
    if problem.process.matrix is not None and not bool(problem.process.matrix.any()):
        calm = SearchArguments(noise, noise_floor, max_iterations=max_iterations)
        settings = settings_of(records, fit_arguments.InitialStates(x0), calm)
        return without_gusts(problem, fitted_in_steps(system, records, settings, monitor))
    return result_of(MaximumSearch(problem, floor, x0 == "free", max_iterations, gain, engine, monitor).in_steps())


def _problem(
    model: nn.Module, system: System, records: Records, process_noise: str | Sequence[str] | Tensor, noise: str | Tensor
) -> FilterProblem:
    """What is to be filtered, as `filter_error` was asked for it."""
    ny, nx = records.outputs.shape[-1], records.states.shape[-1]
    states, units = fit_arguments.state_names(model, nx)
    process = form("process_noise", process_noise, states, units)
    outputs = _outputs_form(noise, getattr(model, "body", None), ny)
    return FilterProblem(system, records, process, outputs, torch.zeros(nx, nx, dtype=torch.float64))


def _outputs_form(noise: str | Tensor, body: Any, ny: int) -> CovarianceForm:
    named = getattr(body, "outputs", ())
    names = tuple(named) if len(named) == ny else tuple(f"y[{i}]" for i in range(ny))
    kind, matrix = fit_arguments.noise_of(noise, ny)
    return form("noise", kind if matrix is None else matrix, names, ("",) * ny)


def _floor(noise_floor: Sequence[float] | Tensor | None, records: Records) -> Tensor:
    smallest = smallest_noise(records)
    floor = fit_arguments.floor_of(noise_floor, len(smallest))
    return smallest if floor is None else torch.maximum(floor, smallest)
