"""All numbers that decide what the closed loop says, each with its reason."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Settings of the search for what a model lacks.

    level : family-wise probability that flights with nothing missing are given any name; the convention.
    confidence : of the set of explanations that flights cannot tell from the best one (Hansen, Lunde and Nason 2011).
    adequate : share of what is missing that names must explain where something without a name is significant beside
        them, and wind or ground of what trims of unseen flights differ by: half, for then they explain more than what
        is left.
    missed : share of cases in which an effect of the smallest visible size is missed; conventional power is 80 %.
    slipped : part of the square of all equations' steps that the deflection of one control must make, for the steps to
        be that control's; in other people's simulators 0.99 of the control that slipped, of others at most 0.47.
    tilt : share of the square of a measured angle that goes with a description, for the cause to lie in that angle: a
        controller may hold the disc where it was, and then no angle goes with what acts.
    gusts : share of flights in calm air in which chance alone may show turbulence: far below the level, for step 3
        then takes the filter in place of output error.
    still : share of its later motion that a control or a rate may make in gusts before the pilot acts.
    segment_s : s, length of the segments of trajectories and of the blocks of residuals on which models are compared:
        longer than what couples errors, short enough for a model that lacks something to stay near the flight.
    settled_s : s after which motors, clocks and a multirotor's turning have settled: residuals by chance are made of
        blocks so long, and thrusts balance in means over so long; over segments so short no model drifts away.
    fits : candidates that are fitted in full side by side, those of largest evidence first; others where none stands.
    """

    level: float = 0.05
    confidence: float = 0.90
    adequate: float = 0.5
    missed: float = 0.2
    slipped: float = 0.9
    tilt: float = 0.2
    gusts: float = 1e-3
    still: float = 0.2
    segment_s: float = 5.0
    settled_s: float = 1.0
    fits: int = 5

    @property
    def draws(self) -> int:
        """Clean aircraft, at most: the fewest with which the smallest p, 1 / (1 + draws), is no more than the level."""
        return math.ceil(1.0 / self.level - 1e-9) - 1

    @property
    def earliest(self) -> int:
        """Draws before which the search does not stop early: half of them, for fewer do not tell the scales."""
        return self.draws // 2

    @property
    def exceeding(self) -> int:
        """Draws that show more than the data after which p = (1 + exceeding) / (1 + draws) stays above the level."""
        return math.floor(self.level * (1 + self.draws) + 1e-9)


SETTINGS = Settings()
"""The settings of every search."""
