"""Where the effects' own states rest under body states and controls."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import torch
from torch import Tensor

from rotorid_torch.core.least_squares import least_squares
from rotorid_torch.core.state import State, StateLayout

PROBE = 1e-4
"""Perturbation of a state for its derivative, in the state's unit."""
STEPS = 4
"""Of Newton's method; rates of such states are nearly linear in them."""


Rates = Callable[[Tensor], Tensor]
"""Rates [..., nx] at states [..., nx]."""


class Flown(Protocol):
    """What is asked of a model."""

    theta: Any
    layout: StateLayout
    body: Any

    @property
    def reference(self) -> Mapping[str, float]:
        """Value of every signal at the reference point."""
        ...

    @property
    def own_states(self) -> tuple[State, ...]:
        """The effects' own states."""
        ...

    def rates(self, theta: Tensor, x: Tensor, u: Tensor) -> Tensor:
        """dx/dt [..., nx]."""
        ...


@torch.no_grad()
def equilibrium(model: Flown, body: Tensor, controls: Tensor, starts_at: Tensor | None = None) -> Tensor:
    """Whole state [..., nx] with the effects' own states at rest under body states and controls; Newton's method.

    States that have a channel start at `starts_at` [..., n] (of all own states), at the reference where that is NaN.
    """
    effect_states = model.own_states
    if not effect_states:
        return body
    start = [model.reference.get(s.channel or s.name, 0.0) for s in effect_states]
    start = torch.tensor(start, dtype=body.dtype, device=body.device)
    start = start if starts_at is None else torch.where(starts_at.isnan(), start, starts_at)
    x = torch.cat([body, start.expand(*body.shape[:-1], len(effect_states))], dim=-1)
    return settled(rates_of(model, controls), x, resting(model))


def rates_of(model: Flown, controls: Tensor) -> Rates:
    """Of a model under controls, by its states."""
    return lambda x: model.rates(model.theta, x, controls)


@torch.no_grad()
def settled(rates_at: Rates, x: Tensor, places: list[int], steps: int = STEPS) -> Tensor:
    """States [..., nx] with those in some places at rest beside the others, by steps of Newton's method."""
    for _ in range(steps if places else 0):
        rates, slopes = _slopes(rates_at, x, places)
        change = least_squares(slopes, rates.unsqueeze(-1)).squeeze(-1)
        x = x.clone()
        x[..., places] -= change.nan_to_num(0.0)
    return x


def resting(model: Flown) -> list[int]:
    """Places in the flat state of the states that start at rest."""
    n = len(model.body.states)
    return [n + k for k, s in enumerate(model.own_states) if s.channel is None]


def _slopes(rates_at: Rates, x: Tensor, places: list[int]) -> tuple[Tensor, Tensor]:
    """Rates of the resting states [..., n], and their derivatives by these states [..., n, n]."""
    steps = PROBE * torch.eye(x.shape[-1], dtype=x.dtype, device=x.device)[places]
    rows = torch.cat([x[None], x + steps.view(len(places), *(1,) * (x.dim() - 1), -1)])
    rates = rates_at(rows)[..., places]
    return rates[0], ((rates[1:] - rates[0]) / PROBE).movedim(0, -1)


def at_rest(model: Flown, body: Tensor, controls: Tensor, starts_at: Tensor) -> Tensor:
    """The same as `equilibrium`, with first derivatives by the parameters, the body's states and `starts_at`.

    Source: implicit function theorem, as one more step of Newton's method with slopes that are held.
    """
    still, places = equilibrium(model, body.detach(), controls.detach(), starts_at.detach()), resting(model)
    if not model.own_states:
        return body
    n = body.shape[-1]
    x = torch.cat([body, torch.where(starts_at.isnan(), still[..., n:], starts_at)], dim=-1)
    if not places:
        return x
    with torch.no_grad():
        _, slopes = _slopes(rates_of(model, controls), still, places)
        inverse = least_squares(slopes, torch.eye(len(places)).to(slopes).expand_as(slopes)).nan_to_num(0.0)
    picked = torch.eye(x.shape[-1], dtype=x.dtype, device=x.device)[places]
    resting_at = x[..., n:].index_copy(-1, torch.tensor(places, device=x.device) - n, still[..., places])
    still = torch.cat([body, resting_at], dim=-1)
    change = (inverse @ model.rates(model.theta, still, controls)[..., places].unsqueeze(-1)).squeeze(-1)
    return still - change @ picked
