"""Steps short enough for the model's fastest pole, beyond which a Runge-Kutta step is wrong and then unstable."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import torch
from torch import Tensor

from rotorid_torch.core.gauss_newton import InfiniteCost
from rotorid_torch.errors import InputError
from rotorid_torch.identification.estimate.segments import Records
from rotorid_torch.identification.estimate.system import System

LARGEST = 0.7
"""Of a pole times a step z: a rule of fourth order has poles off by z**4 / 120 of their size, 0.2 % there, and an
oscillation damped by z**5 / 144 of its size more, a damping ratio of 0.0011; beyond 2.79 it is unstable."""
WANTED = 0.35
"""What shorter steps are made for: an eighth of a thousandth of the pole, a damping ratio of 4e-5."""
MOST = 128
"""Steps a sample is taken in, at most."""
ROUNDS = 6
"""How often steps are made shorter after a fit."""
POINTS = 64
"""Places of the flights at which poles are looked at."""

T = TypeVar("T")


@dataclass(frozen=True)
class Stepped(Generic[T]):
    """A fit, the flights in the steps that it took, and what is to be said of them.

    mended : whether the steps are short enough for what was found.
    """

    fit: T
    records: Records
    remark: str
    mended: bool


def in_steps(
    system: System, records: Records, solve: Callable[[Records, Tensor], T], end: Callable[[T], tuple[Tensor, Tensor]]
) -> Stepped[T]:
    """A fit in steps that are short enough where it starts and where it ends.

    solve : the fit of flights from a start theta [P]. end : theta [P] and states [F, T, nx] that it found.

    Raises InputError: the start has a pole that is too fast, or no run of it is finite.

    Source: Hairer and Wanner, Solving Ordinary Differential Equations II, sec. IV.2 (regions of stability).
    """
    theta, states, interval = system.theta, records.states, records.dt
    taken, fit = 1, None
    for _ in range(ROUNDS + 1):
        pole = fastest(system, theta, records, states)
        times = min(shorter(pole, records.dt), MOST // taken)
        if fit is not None and times == 1:
            break
        records, taken = records.refined(times), taken * times
        if fit is None and shorter(pole, records.dt) > 1:
            said, wish = unfollowed(pole, interval, taken)
            raise InputError("model", "forward", f"{said}, where it starts", wish)
        try:
            fit = solve(records, theta)
        except InfiniteCost:
            wrong = f"diverges where it starts; its fastest pole there is {_named(pole)}"
            raise InputError("model", "forward", wrong, "a start from which runs stay finite") from None
        theta, states = end(fit)
    assert fit is not None
    pole = fastest(system, theta, records, states)
    mended = shorter(pole, records.dt) == 1
    return Stepped(fit, records, _remark(pole, interval, taken, mended), mended)


def fastest(system: System, theta: Tensor, records: Records, states: Tensor) -> complex:
    """The pole of largest size at places spread over the flights; zero where there is none that is finite."""
    inside = torch.arange(records.samples) < records.lengths[:, None]
    where = inside.nonzero()
    where = where[torch.linspace(0, len(where) - 1, min(POINTS, len(where))).long()]
    flight, place = where.unbind(-1)
    first = records.states[flight, 0].nan_to_num(0.0)
    x = torch.where(states[flight, place].isfinite(), states[flight, place], first)
    u, t = records.controls[flight, place], records.start[flight] + place * records.dt
    return fastest_of(system.state_jacobian(theta, t, x, u).detach())


def fastest_of(slopes: Tensor) -> complex:
    """The pole of largest size of Jacobians [n, nx, nx]; zero where there is none that is finite."""
    slopes = slopes[slopes.isfinite().flatten(1).all(dim=1)]
    if not slopes.numel():
        return 0j
    poles = torch.linalg.eigvals(slopes).flatten()
    return complex(poles[poles.abs().argmax()])


def shorter(pole: complex, dt: float) -> int:
    """Steps that one of dt is to be made of; one where the pole is slow enough for it."""
    size = abs(pole) * dt
    return 1 if size <= LARGEST else math.ceil(size / WANTED)


def _remark(pole: complex, interval: float, taken: int, mended: bool) -> str:
    """What to say of the steps, nothing where they are the samples."""
    if not mended:
        return "; ".join(unfollowed(pole, interval, taken))
    limit = f"one step a sample ({interval:.4g} s) follows poles up to {LARGEST / interval:.4g} 1/s"
    return "" if taken == 1 else f"each sample is taken in {taken} steps, for the pole {_named(pole)}: {limit}"


def unfollowed(pole: complex, interval: float, taken: int) -> tuple[str, str]:
    """What is wrong with a pole that even the shortest steps do not follow, and what to do."""
    limit = f"they follow poles up to {LARGEST / interval * taken:.4g} 1/s"
    wrong = f"the pole {_named(pole)} is too fast for {taken} steps a sample of {interval:.4g} s ({limit})"
    return wrong, "time in seconds; a state less, a bound of its parameter, or a higher sample rate"


def _named(pole: complex) -> str:
    return f"{pole.real:.4g}{f' ± {abs(pole.imag):.4g}i' if pole.imag else ''} 1/s"
