"""Step 2 on a multirotor: its thrust curve, control powers and effects from accelerations at measured states.

Parameters that the equations are not linear in, such as those of the control path, which act with memory, are looked
for on a grid, by the misfit of all equations; the others follow by regression. From there least squares move all.
"""

from collections.abc import Sequence
from itertools import product

from torch import Tensor

from rotorid_torch.core.parameters import Parameter
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.base import Role, Stage
from rotorid_torch.identification.measured_states import MeasuredStates
from rotorid_torch.identification.model_estimation import records
from rotorid_torch.identification.model_regression import ModelRegression
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction
from rotorid_torch.identification.regress.ftr import Regression
from rotorid_torch.identification.rotor_equations import RotorEquations, seen_flights, with_values
from rotorid_torch.model.model import Model

TRIED = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5)
"""Values of a parameter with memory that are tried, over its typical one."""
SWEEPS = 3
"""Passes over the parameters with memory where there are several: they trade against each other."""
SEARCHED = 1000
"""Samples of each flight, from its middle, that the search for parameters with memory looks at."""


def regress_rotors(
    model: Model, dataset: Dataset, reconstruction: Reconstruction, begun: bool = False
) -> ModelRegression:
    """Start of step 3 for a multirotor, from the identify flights.

    Parameters that the equations are not linear in start where the model has them, where that is not nothing. begun :
    the others start there too, and no regression in a band is asked for.

    Source: Morelli and Klein, Aircraft System Identification (2nd ed.), ch. 7; Foerster (2015), sec. 3.
    """
    flights = tuple(seen_flights(model, records(model, dataset, reconstruction)))
    bent, theta = nonlinear(model), model.theta.detach().clone()
    linear = [name for name in model.parameter_set.free if name not in bent]
    declared = dict(zip(model.parameter_set.names, model.parameter_set.values.tolist(), strict=True))
    unknown = [name for name in bent if model.named_values[name] == declared[name]]
    if unknown:
        searched = MeasuredStates.of(model, [flight.middle(SEARCHED) for flight in flights])
        theta = _tried(searched, theta, unknown, linear)
    regressions = dict[str, Regression]()
    if not begun:
        theta, regressions = RotorEquations(model, flights).fitted(theta, linear)
    fit = MeasuredStates.of(model, flights).fitted(model.parameter_set.clamp(theta), model.parameter_set.free)
    lines = dict(zip(dataset.identify, fit.lines, strict=True))
    without = dict(zip(dataset.identify, fit.without, strict=False))  # none of one flight alone
    return ModelRegression(regressions, fit.theta, (), {}, fit.errors, lines, without, fit.explained)


def nonlinear(model: Model) -> tuple[str, ...]:
    """Free parameters that the equations are not linear in: of the control path, and those with several starts."""
    by_control = [e.id for e in model.chain if e.stage is Stage.CONTROL and e.role is not Role.NOMINAL]
    every = ((effect.id, p) for effect in model.chain for p in effect.declared)
    return tuple(f"{effect}.{p.name}" for effect, p in every if p.free and (p.tried or effect in by_control))


def curved(model: Model, effect: str) -> bool:
    """Whether an effect of the model that does not act on the controls has parameters with several starts.

    Not those with a motion of their own: each start swings otherwise, and a line for each shows that.
    """
    return any(p.free and p.tried for e in model.chain if e.id == effect and not e.states for p in e.declared)


def _tried(states: MeasuredStates, theta: Tensor, unknown: Sequence[str], linear: Sequence[str]) -> Tensor:
    """Theta with these parameters where all responses together fit best, one size after the other on a grid.

    With each size all values of its effect's shapes are tried: where the size is nothing they say nothing.
    """
    parameter_set = states.equations.model.parameter_set
    declared = [parameter_set.parameters[parameter_set.index(name)] for name in unknown]
    together, grids = _together(unknown, declared), [_grid(p) for p in declared]
    theta = states.fitted(theta, linear).theta
    misfit, misfits = states.misfit(theta, linear), dict[tuple[float, ...], float]()

    def at(values: tuple[float, ...]) -> Tensor:
        return with_values(states.equations.model, theta, dict(zip(unknown, values, strict=True)))

    best = tuple(p.value for p in declared)
    for places in together * (SWEEPS if len(together) > 1 else 1):
        trials = list(product(*(grids[k] if k in places else [value] for k, value in enumerate(best))))
        for trial in trials:
            if trial not in misfits:
                misfits[trial] = misfit(at(trial))
        best = min(trials, key=lambda trial: misfits[trial])
    return at(best)


def _together(names: Sequence[str], declared: Sequence[Parameter]) -> list[tuple[int, ...]]:
    """Places of each size and of its effect's shapes, which start from several values; of shapes alone if no size."""
    effects, together = [name.rpartition(".")[0] for name in names], list[tuple[int, ...]]()
    for effect in dict.fromkeys(effects):
        places = [k for k, one in enumerate(effects) if one == effect]
        shapes = tuple(k for k in places if declared[k].tried)
        together += [(k, *shapes) for k in places if k not in shapes] or [shapes]
    return together


def _grid(parameter: Parameter) -> list[float]:
    """Values at which a parameter is tried."""
    if parameter.tried:
        return list(dict.fromkeys((parameter.value, *parameter.tried)))
    low, high = parameter.bounds
    return [min(max(share * parameter.typical, low), high) for share in TRIED]
