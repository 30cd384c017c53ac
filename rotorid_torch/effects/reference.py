"""Where an effect is at rest: the reference of a data set, as tensors."""

from collections.abc import Sequence

import torch
from torch import Tensor

from rotorid_torch.core.rigid import gravity_in_body
from rotorid_torch.effects.spec import ModelSpec


def reference_of(spec: ModelSpec, names: Sequence[str]) -> Tensor:
    """Reference values of these signals [n]; what the reference does not know is taken as zero."""
    return torch.tensor([spec.reference.get(n, 0.0) for n in names], dtype=torch.float64)


def trim_force(spec: ModelSpec) -> Tensor:
    """Specific force at the reference [3], which carries the weight."""
    return -gravity_in_body(reference_of(spec, ("phi", "theta")), spec.gravity)
