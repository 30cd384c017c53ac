"""Non-augmented unscented Kalman filter with two concatenated unscented transforms, and the unscented RTS smoother.

Sigma points sit at the mean and at +- sqrt(n) columns of the covariance's root (alpha 1, kappa 0, beta 2): no weight
is negative, so that each covariance is a sum of squares (Joseph form) and stays symmetric positive definite.
Two engines do the same to rounding: `core.native`, compiled for the functions at hand, and torch below.
Sources: Julier and Uhlmann, Proc. IEEE 92 (2004); Wu et al., IEEE Signal Processing Letters 12 (2005), on redrawing
the sigma points after the process noise; Sarkka, IEEE Trans. Automatic Control 53 (2008), on the smoother.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.core.native import filtering
from rotorid_torch.core.native.build import threads
from rotorid_torch.core.native.filtering import Weights
from rotorid_torch.core.native.graph.tracing import Unsupported
from rotorid_torch.errors import say_once
from rotorid_torch.identification.arguments import angles_of
from rotorid_torch.identification.own_model import warn_of_turns
from rotorid_torch.identification.reconstruct import sigma_points
from rotorid_torch.identification.reconstruct.filter_problem import (
    Dynamics,
    Filtered,
    Problem,
    checked,
    onward,
    refined,
    with_angles,
)
from rotorid_torch.identification.reconstruct.iterated import iterated, learns_constants
from rotorid_torch.identification.reconstruct.sigma_points import ProcessNoise, divide, root, scaled_weights

Engine = Literal["native", "reference"]
"""compiled code for these functions (CPU), or torch, eager and differentiable"""
WORTH_COMPILING = 500
"""Samples that take torch about as long as a compiler needs for the model."""


def unscented_filter(
    f: Dynamics,
    h: Dynamics,
    x0: Any,
    P0: Any,
    Q: Any,
    R: Any,
    controls: Any,
    outputs: Any,
    dt: float,
    smooth: bool = True,
    angles: Sequence[int] = (),
) -> Filtered:
    """Filter and smooth sampled outputs of dx/dt = f(x, u) + noise, y = h(x, u) + noise, for any f and h.

    Parameters
    ----------
    f, h : f(x, u) -> dx/dt [..., nx] and h(x, u) -> y [..., ny]; both broadcast over x [..., nx], u [..., nu].
        f is integrated by a Runge-Kutta step a sample, controls linear between samples; where it has a pole that is
        too fast for one, by several.
    x0, P0 : [..., nx], [..., nx, nx] mean and covariance of the first sample's state before its outputs are seen.
    Q : [nx, nx] covariance of the noise added to the state at each sample.
    R : [ny, ny] covariance of the outputs' noise.
    controls : [..., T, nu]; nu may be 0.
    outputs : [..., T, ny]; NaN marks a missing one, which is left out exactly.
    dt : sample interval, s.
    smooth : also run the Rauch-Tung-Striebel smoother.
    angles : places of outputs that are angles, rad: innovations are taken within half a turn, wrapped or not.

    Leading dimensions (flights) are a batch. Arrays of numpy are taken as well; all is done in float64.
    To estimate a constant parameter, append it to the state with a rate of zero. Where f or h are not linear with it,
    filter and smoother are then repeated, linearised about what the whole record says (`iterated`), until nothing
    changes: the estimate no longer depends on how far off or how wide the prior was, and reaches the Cramer-Rao bound.

    Returns
    -------
    Filtered : .means .covariances .innovations .innovation_covariances .log_likelihood .smoothed_means
        .smoothed_covariances; .table() .to_dict() ["x[1]"] have the states at the last sample.

    Raises
    ------
    InputError : shapes that do not fit, functions that do not broadcast, NaN in anything but the outputs, a covariance
        that is not symmetric, a pole of f that is too fast for 128 steps a sample.

    Source: Julier and Uhlmann, Proc. IEEE 92 (2004); Sarkka, IEEE Trans. Automatic Control 53 (2008).

    Examples
    --------
    The bias of a gyro from a heading of -pi to pi: psi' = gyro - bias, bias' = 0.

    >>> import numpy as np
    >>> import torch
    >>> import rotorid_torch as rotorid
    >>> rng, dt = np.random.default_rng(0), 0.02
    >>> rate = 0.5 + 0.3 * np.sin(dt * np.arange(1000))
    >>> heading = dt * np.cumsum(rate) + 0.02 * rng.standard_normal(1000)
    >>> found = rotorid.unscented_filter(
    ...     f=lambda x, u: torch.stack([u[..., 0] - x[..., 1], 0.0 * x[..., 1]], dim=-1),
    ...     h=lambda x, u: x[..., :1],
    ...     x0=[0.0, 0.0],
    ...     P0=np.diag([0.1, 0.1]),
    ...     Q=np.diag([1e-8, 0.0]),
    ...     R=[[0.02**2]],
    ...     controls=rate[:, None] + 0.05,
    ...     outputs=(heading[:, None] + np.pi) % (2.0 * np.pi) - np.pi,
    ...     dt=dt,
    ...     angles=[0],
    ... )
    >>> print(f"{float(found.smoothed_means[-1, 1]):.2f}")
    0.05
    """
    smooth = arguments.flag(Argument("unscented_filter", "smooth"), smooth)
    problem = checked(Problem(f, h, x0, P0, Q, R, controls, outputs, dt))
    turning = angles_of("unscented_filter", angles, problem.outputs.shape[-1])
    warn_of_turns(problem.outputs, turning)
    try:
        parts, got = refined(problem, problem.x0.unsqueeze(-2)), None
        while got is None or parts > problem.parts:
            problem = replace(problem, parts=parts)
            got = _filtered(problem, turning, smooth)
            if not bool(got.means.isfinite().all() and got.covariances.isfinite().all()):
                raise torch.linalg.LinAlgError  # pyright: ignore[reportPrivateImportUsage]
            parts = refined(problem, got.means if got.smoothed_means is None else got.smoothed_means)
    except torch.linalg.LinAlgError as error:  # pyright: ignore[reportPrivateImportUsage]
        wrong = "give NaN, or let the covariance of the state grow beyond all numbers, on the way through the record"
        expected = "functions that stay finite near the outputs; a shorter dt, a smaller P0, or other signs in f"
        raise Argument("unscented_filter", "f, h").wrong(wrong, expected) from error
    return got


@torch.no_grad()
def _filtered(problem: Problem, angles: Sequence[int], smooth: bool) -> Filtered:
    """Filter and smoother of a problem, of whose outputs some are angles."""
    near, noise = with_angles(problem, angles), ProcessNoise.constant(problem.Q)

    def single_pass(cov: Tensor, smooth: bool = True) -> Filtered:
        records = near.R, near.controls, near.outputs, near.dt, near.parts
        return filter_and_smooth(SampledSystem(near.f, near.h, (near.x0, cov), noise, *records), smooth)

    if not learns_constants(problem):
        return single_pass(problem.P0, smooth)
    got = iterated(near, single_pass)
    return got if smooth else replace(got, smoothed_means=None, smoothed_covariances=None)


@dataclass(frozen=True, eq=False)
class SampledSystem:
    """A system and its records: f and h as in `unscented_filter`, process noise that may change with time.

    prior : mean [..., nx] and covariance [..., nx, nx] of the first state. R : [ny, ny]. controls : [..., T, nu].
    outputs : [..., T, ny], NaN = missing. dt : s. parts : steps that a sample is taken in.
    """

    f: Dynamics
    h: Dynamics
    prior: tuple[Tensor, Tensor]
    noise: ProcessNoise
    R: Tensor
    controls: Tensor
    outputs: Tensor
    dt: float
    parts: int = 1

    def expanded(self) -> SampledSystem:
        """Prior, controls and outputs with all leading dimensions of the batch."""
        parts = ((self.prior[0], 1), (self.prior[1], 2), (self.controls, 2), (self.outputs, 2))
        batch = np.broadcast_shapes(*(a.shape[:-k] for a, k in parts))
        mean, cov, controls, outputs = (a.expand(*batch, *a.shape[-k:]) for a, k in parts)
        return replace(self, prior=(mean, cov), controls=controls, outputs=outputs)

    @property
    def plain(self) -> bool:
        """Numbers in float64 on the CPU, and nobody asks for derivatives."""
        tensors = (*self.prior, self.noise.values, self.R, self.controls, self.outputs)
        plain = all(a.dtype == torch.float64 and a.device.type == "cpu" for a in tensors)
        return plain and not (torch.is_grad_enabled() and any(a.requires_grad for a in tensors))


def filter_and_smooth(
    system: SampledSystem, smooth: bool = True, weights: Weights | None = None, engine: Engine | None = None
) -> Filtered:
    """`unscented_filter` without its checks, with process noise that may change with time, and any sigma points.

    weights : of other sigma points than those of `scaled_weights`.
    engine : None takes native code from `WORTH_COMPILING` samples on, and says once why where it cannot.

    Raises Unsupported: engine "native", and these functions cannot become native code, or not here.
    """
    system = system.expanded()
    weights = weights or scaled_weights(system.prior[0].shape[-1])
    long = system.outputs.shape[-2] >= WORTH_COMPILING
    if engine == "native" or (engine is None and long and system.plain):
        try:
            return _filter_natively(system, weights, smooth)
        except Unsupported as reason:
            if engine == "native":
                raise
            say_once(f"the filter runs in torch, 30 to 200 times slower than compiled: {reason}")
    return _filter_in_torch(system, weights, smooth)


def _filter_natively(system: SampledSystem, weights: Weights, smooth: bool) -> Filtered:
    """All leading dimensions as one list of flights."""
    (mean, cov), ny = system.prior, system.outputs.shape[-1]
    batch, values = mean.shape[:-1], system.noise.values
    flights = math.prod(batch)
    if values.dim() == 2:
        values = values.unsqueeze(0)
    else:
        values = values.expand(*batch, *values.shape[-2:]).reshape(flights, *values.shape[-2:])

    def listed(a: Tensor, trailing: int) -> Tensor:
        return a.reshape(flights, *a.shape[-trailing:])

    with torch.no_grad():
        mean, controls = listed(mean, 1), listed(system.controls, 2)
        compiled = _compiled(system.f, system.h, mean, controls[:, 0], ny)
        problem = filtering.FlightsToFilter(
            mean=mean,
            covariance=listed(cov, 2),
            R=system.R,
            controls=controls,
            outputs=listed(system.outputs, 2),
            rows=system.noise.rows,
            columns=system.noise.columns,
            values=values,
            dt=system.dt,
            parts=system.parts,
        )
        got = compiled.run(problem, weights, smooth, threads=threads())
    shaped = {name: a if a is None else a.reshape((*batch, *a.shape[1:])) for name, a in vars(got).items()}
    return Filtered(**shaped)  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True, eq=False)
class _Traced:
    """Code of two functions, where they were tried [F, points, nx + nu], and what they gave there."""

    functions: tuple[object, ...]
    probe: Tensor
    gave: Tensor
    code: filtering.CompiledFilter


_TRACED: WeakKeyDictionary[object, _Traced] = WeakKeyDictionary()
"""The last code by the object that f belongs to."""
AWAY = (0.0, 1e-3, 0.3)
"""How far from where they were traced functions are tried: at rest alone, another damping would not show."""


def _compiled(f: Dynamics, h: Dynamics, x: Tensor, u: Tensor, ny: int) -> filtering.CompiledFilter:
    """The code of f and h, traced once; where they give something else than then, they are traced anew."""
    owner = getattr(f, "__self__", f)
    functions = tuple(getattr(g, "__func__", id(g)) for g in (f, h))
    probe = _around(torch.cat([x, u], dim=-1))

    def values(at: Tensor) -> Tensor:
        columns = at.split([x.shape[-1], u.shape[-1]], dim=-1)
        return torch.cat([f(*columns), h(*columns)], dim=-1)

    cached = None
    with suppress(TypeError):  # owners that cannot be keys: without a hash, or without weak references
        cached = _TRACED.get(owner)
    if cached is not None and cached.functions == functions and cached.probe.shape == probe.shape:
        if torch.equal(values(cached.probe), cached.gave):
            return cached.code
    compiled = filtering.CompiledFilter.of(f, h, x, u, ny)
    with suppress(TypeError):
        _TRACED[owner] = _Traced(functions, probe, values(probe), compiled)
    return compiled


def _around(at: Tensor) -> Tensor:
    """Points [F, n] and others beside them, differently in all entries: [F, points, n]."""
    turn = torch.cos(torch.arange(1.0, at.shape[-1] + 1.0, dtype=at.dtype))
    return torch.stack([at + share * (1.0 + at.abs()) * turn for share in AWAY], dim=-2)


def _filter_in_torch(system: SampledSystem, weights: Weights, smooth: bool) -> Filtered:
    mean, cov = system.prior
    tape = _Tape(mean, system.outputs.shape[-2], system.outputs.shape[-1], smooth)
    points = 2 * mean.shape[-1] + 1
    u = system.controls.movedim(-2, 0).unsqueeze(-2).expand(-1, *mean.shape[:-1], points, -1)
    y = system.outputs.movedim(-2, 0)
    missing = y.isnan()
    gaps = missing.flatten(1).any(dim=1).tolist()
    sensors = _Sensors(system.h, system.R, root(system.R))
    for k in range(len(y)):
        if k:
            mean, cov = _predict(tape, system, weights, k - 1, (mean, cov), u)
        sample = _Sample(u[k], y[k], missing[k] if gaps[k] else None)
        mean, cov = _update(tape, sensors, weights, k, (mean, cov), sample)
    if smooth:
        _smooth(tape)
    return tape.result()


class _Sensors(NamedTuple):
    """Outputs h(x, u) and the covariance of their noise, with its root."""

    h: Dynamics
    R: Tensor
    root: Tensor


class _Sample(NamedTuple):
    """Controls, outputs, and which outputs are missing (None: none is)."""

    u: Tensor
    y: Tensor
    missing: Tensor | None


class _Tape:
    """What filter and smoother write down, time first; the smoother overwrites `leak` and reads `gain`."""

    def __init__(self, mean: Tensor, samples: int, ny: int, smooth: bool) -> None:
        batch, nx = mean.shape[:-1], mean.shape[-1]

        def empty(rows: int, *shape: int) -> Tensor:
            return torch.empty(rows, *batch, *shape, dtype=torch.float64, device=mean.device)

        self.mean, self.cov = empty(samples, nx), empty(samples, nx, nx)
        self.innovation, self.spread = empty(samples, ny), empty(samples, ny, ny)
        self.log_likelihood = torch.zeros(batch, dtype=torch.float64, device=mean.device)
        stored = samples if smooth else 0
        self.predicted, self.gain, self.leak = empty(stored, nx), empty(stored, nx, nx), empty(stored, nx, nx)
        self.smoothed = empty(stored, nx)

    def result(self) -> Filtered:
        stored = bool(self.smoothed.shape[0])
        return Filtered(
            means=self.mean.movedim(0, -2),
            covariances=_symmetric(self.cov).movedim(0, -3),
            innovations=self.innovation.movedim(0, -2),
            innovation_covariances=_symmetric(self.spread).movedim(0, -3),
            log_likelihood=self.log_likelihood,
            smoothed_means=self.smoothed.movedim(0, -2) if stored else None,
            smoothed_covariances=_symmetric(self.leak).movedim(0, -3) if stored else None,
        )


def _predict(
    tape: _Tape, system: SampledSystem, weights: Weights, k: int, state: tuple[Tensor, Tensor], u: Tensor
) -> tuple[Tensor, Tensor]:
    """Process transform from sample k to k + 1; the smoother's gain and the covariance it cannot remove."""
    (mean, cov), Q = state, system.noise.at(k)
    offsets, root_weight = sigma_points.offsets(root(cov), weights), sigma_points.root_weights(mean, weights)
    points = onward(system.f, mean.unsqueeze(-2) + offsets, u[k], u[k + 1], system.dt, system.parts)
    ahead = sigma_points.mean_of(points, weights)
    spread = root_weight * (points - ahead.unsqueeze(-2))
    cov_ahead = spread.mT @ spread + Q
    if tape.gain.shape[0]:
        start = root_weight * offsets
        gain = divide(start.mT @ spread, cov_ahead)
        residual = start - spread @ gain.mT
        tape.predicted[k + 1], tape.gain[k], tape.leak[k] = ahead, gain, residual.mT @ residual + gain @ Q @ gain.mT
    return ahead, cov_ahead


def _update(
    tape: _Tape, sensors: _Sensors, weights: Weights, k: int, state: tuple[Tensor, Tensor], sample: _Sample
) -> tuple[Tensor, Tensor]:
    """Measurement transform on redrawn sigma points; rows that are missing get no cross covariance, so no gain."""
    (mean, cov), (u, y, missing) = state, sample
    offsets, root_weight = sigma_points.offsets(root(cov), weights), sigma_points.root_weights(mean, weights)
    points = sensors.h(mean.unsqueeze(-2) + offsets, u)
    expected = sigma_points.mean_of(points, weights)
    start, spread = root_weight * offsets, root_weight * (points - expected.unsqueeze(-2))
    innovation, S = y - expected, spread.mT @ spread + sensors.R
    tape.innovation[k], tape.spread[k] = innovation, S
    count = y.shape[-1]
    if missing is not None:
        present = (~missing).to(S.dtype)
        innovation, spread = innovation.nan_to_num(nan=0.0), spread * present.unsqueeze(-2)
        S = S * present.unsqueeze(-1) * present.unsqueeze(-2) + torch.diag_embed(1.0 - present)
        count = present.sum(dim=-1)
    root_S = torch.linalg.cholesky(S)
    gain = torch.cholesky_solve(spread.mT @ start, root_S).mT
    factor = torch.cat([start - spread @ gain.mT, (gain @ sensors.root).mT], dim=-2)
    white = torch.linalg.solve_triangular(root_S, innovation.unsqueeze(-1), upper=False).squeeze(-1)
    logdet = root_S.diagonal(dim1=-2, dim2=-1).log().sum(dim=-1)
    tape.log_likelihood -= 0.5 * (white.square().sum(dim=-1) + count * math.log(2.0 * math.pi)) + logdet
    tape.mean[k] = mean = mean + (gain @ innovation.unsqueeze(-1)).squeeze(-1)
    tape.cov[k] = cov = factor.mT @ factor
    return mean, cov


def _smooth(tape: _Tape) -> None:
    """Rauch-Tung-Striebel recursion; the covariance is the leak plus what the next sample passes back."""
    tape.smoothed[-1], tape.leak[-1] = tape.mean[-1], tape.cov[-1]
    for k in range(len(tape.mean) - 2, -1, -1):
        change = tape.smoothed[k + 1] - tape.predicted[k + 1]
        tape.smoothed[k] = tape.mean[k] + (tape.gain[k] @ change.unsqueeze(-1)).squeeze(-1)
        tape.leak[k] += tape.gain[k] @ tape.leak[k + 1] @ tape.gain[k].mT


def _symmetric(cov: Tensor) -> Tensor:
    """Rounding of the matrix products taken out; in place, piece by piece, to spare memory unless derivatives flow."""
    if cov.requires_grad:
        return 0.5 * (cov + cov.mT)
    for part in cov.split(256):
        part.copy_(0.5 * (part + part.mT))
    return cov
