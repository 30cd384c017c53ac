"""Dynamic inflow of the main rotor: three states, in the shaft frame, regular in hover and in sideslip.

The usual wind-axes matrices are written here with a vector (the wake's sweep) instead of an angle, so that
nothing is undefined when the speed is zero.
"""

from __future__ import annotations

import numpy as np

from rotorid_torch.fly.section import Array

MASS = (128.0 / (75.0 * np.pi), 16.0 / (45.0 * np.pi))
SKEW = 15.0 * np.pi / 64.0


def wake_sweep(advance: Array, through: Array) -> Array:
    """How far the wake is swept: vector with the length tan(half the skew angle) along the wake's drift.

    Parameters
    ----------
    advance : (2, ...) hub velocity over tip speed along (aft, right).
    through : (...) flow through the disc over tip speed, positive down through the rotor.

    Returns
    -------
    (2, ...) along (aft, right).
    """
    total = np.sqrt((advance * advance).sum(0) + through * through)
    return -advance / np.maximum(total + through, 0.02)


def inflow_rates(inflow: Array, loading: Array, advance: Array, climb: Array, speed: Array) -> tuple[Array, Array]:
    """Rates of the inflow states, and the wake's sweep.

    The inflow ratio at radius r and azimuth psi (0 aft, in the direction of rotation) is
    lambda0 + (r/R) (lambda_c cos psi + lambda_s sin psi), positive down.

    Parameters
    ----------
    inflow : (3, ...) lambda0, lambda_c (along aft), lambda_s (along right).
    loading : (3, ...) thrust coefficient and its first moments along (aft, right), aerodynamic only.
    advance : (2, ...) hub velocity over tip speed along (aft, right).
    climb : (...) hub velocity over tip speed along the shaft, positive up.
    speed : (...) rotor speed, rad/s.

    Returns
    -------
    (3, ...) rates, 1/s, and (2, ...) `wake_sweep`.

    Source: Pitt and Peters, Vertica 5 (1981); Peters and HaQuang, J. AHS 33(4) (1988): L and mass-flow matrices.
    """
    mean, gradient = inflow[0], inflow[1:]
    through = mean + climb
    planar = (advance * advance).sum(0)
    total = np.sqrt(planar + through * through) + 1e-9
    sweep = wake_sweep(advance, through)
    square = (sweep * sweep).sum(0)
    flow = total * mean
    slope = (planar + through * (through + mean)) / total * gradient
    along = (sweep * slope).sum(0)
    determinant = 1.0 - square + SKEW * SKEW * square
    needed0 = (2.0 * (1.0 - square) * flow + SKEW * along) / determinant
    crossing = 0.5 / (1.0 + square)
    needed = crossing * slope + sweep * ((along * (2.0 - SKEW * SKEW) * crossing - SKEW * flow) / determinant)
    rates = np.empty_like(inflow)
    rates[0] = (loading[0] - needed0) * speed / MASS[0]
    rates[1:] = (loading[1:] - needed) * speed / MASS[1]
    return rates, sweep
