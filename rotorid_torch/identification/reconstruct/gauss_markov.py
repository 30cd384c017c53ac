"""Power and time constant of forces as first-order Gauss-Markov processes, by maximum likelihood of the innovations.

Six scalar problems a flight (X Y Z L M N over mass and inertia), each df/dt = -(f - f0)/tau + w, seen through its
measured value (accelerometer) or its measured integral (gyro, velocity without kinematics). The power of w is
q(t) = sum of theta_j a_j(t) with a_0 = 1 and a_j >= 0 what the controls do: forces move when controls move.
All scalar filters run side by side as rows of one recursion, so that a search costs less than one pass of the full
filter, which then uses what is found here.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch

from rotorid_torch.core.native.build import lanes, library, threads
from rotorid_torch.core.recursion import followed, linear
from rotorid_torch.errors import Unsupported, say_once

Array = np.ndarray
Engine = Literal["native", "reference"]

SEARCH_STEP_S = 0.02
"""Samples are averaged to about this interval while powers are searched."""
SWEEPS = 14
TAUS_S = np.geomspace(0.125, 8.0, 7)
MEMORIES_S = (0.0, 0.1, 0.5)
"""How long a moved control keeps shaking the forces: at once, the rotor's flapping, its lead-lag and the body."""
SMEAR_S = 0.5
"""Width over which realised and expected process noise are compared."""
LARGEST_SCALE = 30.0
CONSTANTS = np.geomspace(1e-6, 0.25, 19)
"""Constant powers that are tried, as shares of the sum of all powers."""
ALLOWED_LOSS = 2.0
SIDE_BY_SIDE = 1200
"""Rows of one pass while candidates are compared; more are no faster and need their memory."""


@dataclass(frozen=True)
class Series:
    """Scalar records side by side.

    value : [T, N] record, NaN where missing; integral : [N] whether it is the integral of f rather than f itself.
    noise : [N] standard deviation of a sample; dt : s.
    """

    value: Array
    integral: Array
    noise: Array
    dt: float

    def averaged(self, block: int) -> Series:
        """Means over blocks of samples; a block that misses a sample is missing."""
        return Series(block_means(self.value, block), self.integral, self.noise / math.sqrt(block), self.dt * block)


@dataclass(frozen=True)
class Pass:
    """Result of one filter and smoother pass over rows.

    log_likelihood : [N]; realised, expected : [T, N] square of the smoothed process noise over its power, and what
    the model expects of it (their difference is twice the score); trim : [N] generalised least squares of f0.
    """

    log_likelihood: Array
    realised: Array
    expected: Array
    trim: Array


def block_means(value: Array, block: int) -> Array:
    """Means over blocks along the first axis; what is left over at the end is dropped."""
    count = len(value) // block
    return value[: count * block].reshape(count, block, *value.shape[1:]).mean(axis=1)


def smooth_rows(
    rows: Series, power: Array, tau: Array, trim: Array, spread: Array, engine: Engine | None = None
) -> Pass:
    """Kalman filter and adjoint (Bryson-Frazier) smoother of every row.

    power : [T, N] spectral density of w, unit of f squared per s.
    tau, trim, spread : [N] time constant (s), f0, and standard deviation of f about f0 at the first sample.
    engine : compiled or in numpy; by default compiled where there is a compiler.

    Source: de Jong, Biometrika 75 (1988), on the score from the adjoint state; Bryson and Ho, Applied Optimal Control.
    """
    if engine != "reference":
        try:
            return _smooth_natively(rows, power, tau, trim, spread)
        except Unsupported as reason:
            if engine == "native":
                raise
            say_once(f"the search for the forces' bandwidth runs uncompiled, ten times slower: {reason}")
    return _smooth_in_numpy(rows, power, tau, trim, spread)


class _Task(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_int64) for name in ("samples", "count")),
        ("dt", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ("value", "power", "integral", "noise", "tau", "trim", "spread")),
        *((name, ctypes.c_void_p) for name in ("likelihood", "realised", "expected", "level")),
    ]


def _smooth_natively(rows: Series, power: Array, tau: Array, trim: Array, spread: Array) -> Pass:
    """The recursion in native code, rows filled up to whole vectors with copies of the last."""
    code = library('#include "gauss_markov.h"\n')
    samples, count = rows.value.shape
    more = -count % lanes()

    def padded(values: Array) -> Array:
        width = [(0, 0)] * (values.ndim - 1) + [(0, more)]
        return np.ascontiguousarray(np.pad(np.asarray(values, dtype=float), width, mode="edge"))

    each = {"integral": rows.integral, "noise": rows.noise, "tau": tau, "trim": trim, "spread": spread}
    arrays = {name: padded(np.broadcast_to(values, (count,))) for name, values in each.items()}
    arrays |= {"value": padded(rows.value), "power": padded(np.broadcast_to(power, (samples, count)))}
    total = count + more
    results = {name: np.zeros(total) for name in ("likelihood", "level")}
    results |= {name: np.zeros((samples, total)) for name in ("realised", "expected")}
    places = {name: array.ctypes.data for name, array in (arrays | results).items()}
    code.gauss_markov(ctypes.byref(_Task(samples=samples, count=total, dt=rows.dt, **places)), threads())
    likelihood, realised, expected, level = (results[n] for n in ("likelihood", "realised", "expected", "level"))
    return Pass(likelihood[:count], realised[:, :count], expected[:, :count], level[:count])


def _smooth_in_numpy(rows: Series, power: Array, tau: Array, trim: Array, spread: Array) -> Pass:
    dt, h0 = rows.dt, rows.integral.astype(float)
    h1, e = 1.0 - h0, np.exp(-dt / tau)
    a = h0 * tau * (1.0 - e)
    q00, q01, q11 = h0 * dt**3 / 3.0, h0 * dt**2 / 2.0, dt
    samples, count = rows.value.shape
    R = rows.noise**2
    time = dt * np.arange(samples)[:, None]
    y = rows.value - trim * (h0 * time + h1)
    present = ~np.isnan(y)
    y = np.where(present, y, 0.0)
    first = present.argmax(axis=0)
    s, f = h0 * y[first, np.arange(count)], np.zeros(count)
    sg, fg = np.zeros(count), np.zeros(count)
    p00, p01, p11 = h0 * 1e4 * R, np.zeros(count), spread**2 + 1e-6 * R
    history = np.empty((4, samples, count))
    log_likelihood, top, bottom = np.zeros(count), np.zeros(count), np.zeros(count)
    for k in range(samples):
        c0, c1 = h0 * p00 + h1 * p01, h0 * p01 + h1 * p11
        S = h0 * c0 + h1 * c1 + R
        w = present[k] / S
        v, g = y[k] - h0 * s - h1 * f, h0 * (time[k] - sg) + h1 * (1.0 - fg)
        k0, k1, vw = c0 * w, c1 * w, v * w
        history[0, k], history[1, k], history[2, k], history[3, k] = w, k0, k1, vw
        log_likelihood -= 0.5 * (v * vw + present[k] * np.log(S))
        top += g * vw
        bottom += g * g * w
        s, f, sg, fg = s + k0 * v, f + k1 * v, sg + k0 * g, fg + k1 * g
        p00, p01, p11 = p00 - k0 * c0, p01 - k0 * c1, p11 - k1 * c1
        s, f, sg, fg = s + a * f, e * f, sg + a * fg, e * fg
        q = power[min(k + 1, samples - 1)]
        p00 = p00 + a * (2.0 * p01 + a * p11) + q * q00
        p01, p11 = e * (p01 + a * p11) + q * q01, e * e * p11 + q * q11
    realised, expected = _adjoint(history, h0, h1, a, e, (q00, q01, q11))
    return Pass(log_likelihood, realised, expected, trim + top / (bottom + 1.0 / (spread**2 + 1e-6 * R)))


def _adjoint(
    history: Array, h0: Array, h1: Array, a: Array, e: Array, Q: tuple[Array, Array, float]
) -> tuple[Array, Array]:
    """Backward recursion of adjoint state r and its information N: r'Qr and trace(QN) at every sample."""
    samples, count = history.shape[1:]
    q00, q01, q11 = Q
    r0, r1, n00, n01, n11 = np.zeros((5, count))
    realised, expected = np.zeros((2, samples, count))
    for k in range(samples - 1, 0, -1):
        w, k0, k1, vw = history[:, k]
        t = vw - k0 * r0 - k1 * r1
        r0, r1 = r0 + h0 * t, r1 + h1 * t
        u0, u1 = n00 * k0 + n01 * k1, n01 * k0 + n11 * k1
        kk = k0 * u0 + k1 * u1 + w
        n00, n01, n11 = n00 + h0 * (kk - 2.0 * u0), n01 - h0 * u1 - h1 * u0, n11 + h1 * (kk - 2.0 * u1)
        realised[k] = r0 * (q00 * r0 + 2.0 * q01 * r1) + q11 * r1 * r1
        expected[k] = q00 * n00 + 2.0 * q01 * n01 + q11 * n11
        r1 = a * r0 + e * r1
        n11 = a * (a * n00 + 2.0 * e * n01) + e * e * n11
        n01 = a * n00 + e * n01
    return realised, expected


@dataclass(frozen=True)
class Sources:
    """What drives the forces of all rows, and which rows have parameters in common.

    activity : [T, N, J] what each source of process noise does, the first one constant.
    axis, group : [N] index of the axis of a row, which shares theta, and of its group, which shares tau.
    spread : [N] standard deviation of f about its trim.
    """

    activity: Array
    axis: Array
    group: Array
    spread: Array

    def power(self, theta: Array) -> Array:
        """Power of the process noise [T, N] for powers theta [axes, J] of the sources."""
        return np.einsum("tnj,nj->tn", self.activity, theta[self.axis])


def find_power(rows: Series, sources: Sources) -> tuple[Array, Array]:
    """Powers theta [axes, J] and time constants [groups] that make the records of all rows most likely.

    Multiplicative steps theta_j *= sum a_j realised / sum a_j expected: each raises the likelihood of all axes at once
    and keeps theta positive.
    Source: Fevotte, Bertin and Durrieu, Neural Computation 21 (2009), for variances that are sums of positive parts.
    """
    activity, axis, spread = sources.activity, sources.axis, sources.spread
    axes, count = int(axis.max()) + 1, activity.shape[-1]
    start = np.array([np.mean(spread[axis == i] ** 2) if (axis == i).any() else 1.0 for i in range(axes)])
    theta = np.repeat(start[:, None], count, axis=1) * 2.0 / count + 1e-300
    taus, trim = np.ones(int(sources.group.max()) + 1), np.zeros(len(axis))
    for sweep in range(SWEEPS):
        if sweep == SWEEPS // 2:
            taus = _find_tau(rows, sources.power(theta), sources.group, trim, spread)
        got = smooth_rows(rows, sources.power(theta), taus[sources.group], trim, spread)
        trim = got.trim
        for i in range(axes):
            mine = axis == i
            if mine.any():
                parts = got.realised[:, mine], got.expected[:, mine]
                top, bottom = (np.einsum("tnj,tn->j", activity[:, mine], part) for part in parts)
                theta[i] *= np.clip(top / np.maximum(bottom, 1e-300), 0.05, 20.0)
    return theta, taus


def largest_constant(rows: Series, sources: Sources, theta: Array, taus: Array) -> Array:
    """Theta with the constant part as large as the data allow: 2 units of log-likelihood below the most likely.

    What forces do while the controls rest is often below the sensors' noise; "nothing" is then the most likely power,
    but not the only one, and errors computed from it would be far too small.
    """
    axis, tau, spread = sources.axis, taus[sources.group], sources.spread
    trial = theta.sum(axis=1, keepdims=True) * CONSTANTS
    added = np.concatenate([np.zeros((len(theta), 1)), trial], axis=1)[axis]
    power = sources.power(theta)
    trim = smooth_rows(rows, power, tau, np.zeros(len(axis)), spread).trim
    together = max(1, SIDE_BY_SIDE // len(axis))
    parts = [added[:, j : j + together] for j in range(0, added.shape[1], together)]
    score = np.concatenate([_likelihoods(rows, power, part, tau, trim, spread) for part in parts])
    raised = theta.copy()
    for i in np.unique(axis):
        total = score[:, axis == i].sum(axis=1)
        allowed = np.flatnonzero(total >= total[0] - ALLOWED_LOSS)
        raised[i, 0] += added[axis == i][0, allowed.max()]
    return raised


def _likelihoods(rows: Series, power: Array, added: Array, tau: Array, trim: Array, spread: Array) -> Array:
    """Log-likelihoods [count, N] with each of the constants added [N, count] to the power, all as rows of one pass."""
    n, count = added.shape
    many = Series(np.tile(rows.value, (1, count)), np.tile(rows.integral, count), np.tile(rows.noise, count), rows.dt)
    more = np.concatenate([power + added[:, j] for j in range(count)], axis=1)
    got = smooth_rows(many, more, np.tile(tau, count), np.tile(trim, count), np.tile(spread, count))
    return got.log_likelihood.reshape(count, n)


def _find_tau(rows: Series, power: Array, group: Array, trim: Array, spread: Array) -> Array:
    """Time constant of each group by its likelihood over a grid, all candidates as rows of one pass."""
    n, count = len(group), len(TAUS_S)
    many = Series(np.tile(rows.value, (1, count)), np.tile(rows.integral, count), np.tile(rows.noise, count), rows.dt)
    alike = np.tile(trim, count), np.tile(spread, count)
    got = smooth_rows(many, np.tile(power, (1, count)), np.repeat(TAUS_S, n), *alike)
    score = got.log_likelihood.reshape(count, n)
    by_group = (score[:, group == g].sum(axis=1) for g in range(group.max() + 1))
    return np.array([_peak(np.log(TAUS_S), row) for row in by_group])


def _peak(log_tau: Array, score: Array) -> float:
    """Top of the parabola through the best grid point and its neighbours; the grid's end where the best is there."""
    i = int(score.argmax())
    if i in (0, len(score) - 1):
        return float(np.exp(log_tau[i]))
    curve = score[i - 1] - 2.0 * score[i] + score[i + 1]
    shift = 0.5 * (score[i - 1] - score[i + 1]) / curve if curve < 0.0 else 0.0
    return float(np.exp(log_tau[i] + shift * (log_tau[1] - log_tau[0])))


def local_scale(got: Pass, power: Array, dt: float, least: float | Array, width_s: float = SMEAR_S) -> Array:
    """How much stronger the process noise is, locally, than the model expects: [T, N], from `least` to 30.

    Realised over expected energy within a Gaussian of that width. Where a force is silent, nothing but measurement
    noise is left of the realised part, which is `least` of what is expected.
    """
    top, bottom = smear(got.realised * power, dt, width_s), smear(got.expected * power, dt, width_s)
    return np.clip(top / np.maximum(bottom, 1e-300), least, LARGEST_SCALE)


def smear(value: Array, dt: float, width_s: float) -> Array:
    """Gaussian running mean along the first axis, mirrored at the ends."""
    half = min(max(1, round(4.0 * width_s / dt)), len(value) - 1)
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) * dt / width_s) ** 2)
    padded = np.pad(value, ((half, half), (0, 0)), mode="reflect")
    length = len(padded) + 2 * half
    spectrum = np.fft.rfft(padded, length, axis=0) * np.fft.rfft(kernel / kernel.sum(), length)[:, None]
    return np.maximum(np.fft.irfft(spectrum, length, axis=0)[2 * half : 2 * half + len(value)], 0.0)


def control_activity(controls: Array, noise: Array, dt: float) -> Array:
    """What controls [T, nu] do, as [T, J >= 1] positive columns: 1, then the square of each control's rate, remembered.

    The rate is that of a running mean over 40 ms; the part that the controls' own noise [nu] makes is taken off.
    Columns are not scaled.
    """
    h = max(1, round(0.02 / dt))
    padded = np.pad(controls, ((2 * h, 2 * h), (0, 0)), mode="edge")
    means = np.lib.stride_tricks.sliding_window_view(padded, 2 * h + 1, axis=0).mean(axis=-1)
    rate = (means[2 * h :] - means[: -2 * h]) / (2 * h * dt)
    floor = 8.0 * noise**2 / (2 * h + 1) / (2 * h * dt) ** 2
    square = np.maximum(rate**2 - floor, 0.0)
    columns = [np.ones((len(controls), 1))]
    for memory in MEMORIES_S:
        columns.append(square if memory == 0.0 else _remembered(square, memory, dt, 2 * h))
    return np.concatenate(columns, axis=1)


def _remembered(square: Array, memory: float, dt: float, lead: int) -> Array:
    """First-order lag, moved forward by the half width of the rate's window."""
    e, driven = math.exp(-dt / memory), torch.from_numpy(square)
    decay = driven.new_full((1, 1), e)
    passed = followed(linear, torch.zeros_like(driven[0]), decay, (1.0 - e) * driven).numpy()
    return np.concatenate([passed[lead:], np.repeat(passed[-1:], lead, axis=0)])[: len(passed)]
