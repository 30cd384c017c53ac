"""Look-up in a table of a model: linear between its knots, on both engines."""

import torch
from torch import Tensor

from rotorid_torch.errors import InputError


def lookup(x: Tensor, knots: Tensor, values: Tensor) -> Tensor:
    """Value at x, linear between knots and held outside them.

    Work grows with the number of knots: for tables of tens. At a knot the derivative is that from below.

    Parameters
    ----------
    x : [...] where to look.
    knots : [n] increasing, the same for all; no parameter of the model.
    values : [..., n] at the knots; leading dimensions broadcast against those of x. They may be parameters.

    Returns
    -------
    [...] in the unit of values.

    Raises
    ------
    InputError : knots that do not increase, or fewer than two, or not as many values.
    """
    if knots.dim() != 1 or len(knots) < 2 or not bool((knots.diff() > 0.0).all()):
        raise InputError("lookup", "knots", f"are {knots.tolist()}", "two or more increasing numbers")
    if values.shape[-1:] != knots.shape:
        raise InputError("lookup", "values", f"have shape {tuple(values.shape)}", f"(..., {len(knots)}) like the knots")
    x, start = x.unsqueeze(-1), knots[:-1]
    ramps = torch.where(x <= start, 0.0, (x - start) / knots.diff()).clamp(max=1.0)
    return values[..., 0] + (values.diff(dim=-1) * ramps).sum(dim=-1)
