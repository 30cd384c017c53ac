"""Dynamic inflow of the main rotor: three states, in the shaft frame, regular in hover and in sideslip.

The usual wind-axes matrices are written here with a vector (the wake's sweep) instead of an angle, so that
nothing is undefined when the speed is zero.
"""

from dataclasses import dataclass

import numpy as np

from rotorid_torch.simulation.rigid import Array

MASS = (128.0 / (75.0 * np.pi), 16.0 / (45.0 * np.pi))
SKEW = 15.0 * np.pi / 64.0


@dataclass(frozen=True)
class Wake:
    """What a rotor's wake does beyond dynamic inflow; the defaults are the plain one.

    `apparent_mass` multiplies the inflow's inertia, `translation` the speed along the disc that feeds its mass flow.
    `distortion`: K_R, inflow gradient by the tilting of the disc; `ground`: part of the ground effect.
    """

    apparent_mass: float = 1.0
    translation: float = 1.0
    distortion: float = 0.0
    ground: float = 0.0


PLAIN = Wake()


def wake_sweep(advance: Array, through: Array) -> Array:
    """How far the wake is swept: vector with the length tan(half the skew angle) along the wake's drift.

    advance : (2, ...) hub velocity over tip speed along (aft, right).
    through : (...) flow through the disc over tip speed, positive down through the rotor.

    Returns (2, ...) along (aft, right).
    """
    total = np.sqrt((advance * advance).sum(0) + through * through)
    return -advance / np.maximum(total + through, 0.02)


def inflow_rates(
    inflow: Array, loading: Array, over_tip: Array, speed: Array, wake: Wake = PLAIN, curvature: Array | None = None
) -> tuple[Array, Array]:
    """Rates of the inflow states, and the wake's sweep.

    The inflow ratio at radius r and azimuth psi (0 aft, in the direction of rotation) is
    lambda0 + (r/R) (lambda_c cos psi + lambda_s sin psi), positive down.

    inflow : (3, ...) lambda0, lambda_c (along aft), lambda_s (along right).
    loading : (3, ...) thrust coefficient and its first moments along (aft, right), aerodynamic only.
    over_tip : (3, ...) hub velocity over tip speed along (aft, right), and along the shaft, positive up.
    speed : (...) rotor speed, rad/s.
    wake : its apparent mass and distortion count here.
    curvature : (2, ...) of the wake along (aft, right), see `curvature_rates`; None for a straight wake.

    Returns (3, ...) rates, 1/s, and (2, ...) `wake_sweep`.

    Source: Pitt and Peters, Vertica 5 (1981); Peters and HaQuang, J. AHS 33(4) (1988): L and mass-flow matrices;
    Zhao, Prasad, Peters, AHS Forum 60 (2004): gradient by a curved wake, which fades as the wake is swept away.
    """
    mean, gradient, advance, climb = inflow[0], inflow[1:], over_tip[:2], over_tip[2]
    through = mean + climb
    planar = (advance * advance).sum(0)
    total = np.sqrt(planar + through * through) + 1e-9
    sweep = wake_sweep(advance, through)
    square = (sweep * sweep).sum(0)
    if curvature is not None:
        gradient = gradient - wake.distortion * (1.0 - square) * curvature
    flow = total * mean
    slope = (planar + through * (through + mean)) / total * gradient
    along = (sweep * slope).sum(0)
    determinant = 1.0 - square + SKEW * SKEW * square
    needed0 = (2.0 * (1.0 - square) * flow + SKEW * along) / determinant
    crossing = 0.5 / (1.0 + square)
    needed = crossing * slope + sweep * ((along * (2.0 - SKEW * SKEW) * crossing - SKEW * flow) / determinant)
    rates = np.empty_like(inflow)
    rates[0] = (loading[0] - needed0) * speed / (MASS[0] * wake.apparent_mass)
    rates[1:] = (loading[1:] - needed) * speed / (MASS[1] * wake.apparent_mass)
    return rates, sweep


CURVATURE_LAG = 32.0 / (15.0 * np.pi)


def curvature_rates(curvature: Array, tilting: Array, mean: Array, advance: Array, climb: Array, speed: Array) -> Array:
    """Rates of the wake's curvature, which follows the tilting of the disc as fast as the flow carries the wake away.

    curvature, tilting : (2, ...) along (aft, right), positive where the disc's edge goes down; tilting in rad/s.
    mean : (...) mean inflow ratio; advance, climb, speed as in `inflow_rates`.

    Source: Zhao, Prasad, Peters, AHS Forum 60 (2004) (dynamic wake distortion).
    """
    total = np.sqrt((advance * advance).sum(0) + (mean + climb) ** 2)
    return (tilting / speed - curvature) * (total * speed / CURVATURE_LAG)


def ground_factor(strength: float, radius: float, above: Array, ahead: Array, induced: Array) -> Array:
    """Part of the induced velocity that the ground's image of the rotor takes away, at most a half.

    strength : one for the image source.
    radius, above : of the rotor, and its height above ground, m.
    ahead, induced : speed along the ground and mean induced velocity, m/s.

    Source: Cheeseman and Bennett, ARC R&M 3021 (1955).
    """
    image = (0.25 * radius / np.maximum(above, 0.25 * radius)) ** 2
    return np.minimum(strength * image / (1.0 + (ahead / np.maximum(induced, 0.1)) ** 2), 0.5)
