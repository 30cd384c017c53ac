"""The model linearised at its reference: A, B, C, D with names, units and trim, as .json or .mat."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from rotorid_torch.core.names import unit
from rotorid_torch.errors import InputError
from rotorid_torch.exporting.signal_path import times
from rotorid_torch.exporting.subject import Subject
from rotorid_torch.model.modes import jacobian, state_matrix

FORMS = (".json", ".mat")


def write_state_space(subject: Subject, path: Path) -> None:
    """Write the linear model; InputError for another ending than .json and .mat."""
    if path.suffix not in FORMS:
        raise InputError(path, "--statespace", f"ends with '{path.suffix}'", " or ".join(FORMS))
    system = state_space(subject)
    if path.suffix == ".json":
        path.write_text(json.dumps(system, indent=1, default=lambda array: array.tolist()))
        return
    from scipy.io import savemat

    savemat(path, _with_cells(system))


def state_space(subject: Subject) -> dict[str, Any]:
    """dx/dt = A (x - x0) + B (u - u0) + rates0, y = C (x - x0) + D (u - u0) + y0, all SI.

    A, B, C, D are derivatives at the reference. A control counts as it is recorded: what its way does at once is in B
    and D, and delays and lags of that way stand beside it in s, as those of the outputs do.
    """
    model = subject.model
    x, u = model.reference_point
    theta = model.theta.detach()
    through = jacobian(lambda v: model.tape(v.expand(4, -1), subject.step)[-1], u)
    forces = jacobian(lambda v: model.rates(theta, x, v), u)
    direct = jacobian(lambda v: model.outputs_at(theta, x, v), u)
    matrices = {"A": state_matrix(model), "B": forces @ through}
    matrices |= {"C": jacobian(lambda a: model.outputs_at(theta, a, u), x), "D": direct @ through}
    delay, lag = times(model, "DELAY"), times(model, "LAG")
    units, outputs = [subject.unit(n) for n in model.body.controls], model.body.outputs
    trim = {"x": x, "u": u, "y": model.outputs_at(theta, x, u).detach(), "rates": model.rates(theta, x, u).detach()}
    return {
        "format": 1,
        "title": subject.title,
        **{name: matrix.detach().numpy() for name, matrix in matrices.items()},
        "states": {"name": list(model.layout.names), "unit": [s.unit for s in model.layout.states]},
        "inputs": {"name": list(model.body.controls), "unit": units, **_times(delay[0], lag[0])},
        "outputs": {"name": list(outputs), "unit": [unit(n) for n in outputs], **_times(delay[1], lag[1])},
        "trim": {name: value.numpy() for name, value in trim.items()},
    }


def _times(delay: Tensor, lag: Tensor) -> dict[str, np.ndarray]:
    return {"delay_s": delay.detach().numpy(), "lag_s": lag.detach().numpy()}


def _with_cells(value: Any) -> Any:
    """Lists of words as cell arrays, which .mat files have."""
    if isinstance(value, dict):
        return {name: _with_cells(item) for name, item in value.items()}
    return np.array(value, dtype=object) if isinstance(value, list) else value
