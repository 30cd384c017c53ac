"""All numbers that decide what the closed loop says, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Settings of the search for what a model lacks.

    level : family-wise probability that flights with nothing missing are given any name; the convention.
    confidence : of the set of explanations that flights cannot tell from the best one (Hansen, Lunde and Nason 2011).
    adequate : share of what is missing that names must explain where something without a name is significant beside
        them: half, for then they explain more than what is left.
    draws : clean aircraft: with 1 / level - 1 the smallest p is the level.
    earliest : draws before which the search does not stop early: half of them, for fewer do not tell the scales.
    exceeding : draws that show more than the data after which the search stops: with one, p stays above the level.
    missed : share of cases in which an effect of the smallest visible size is missed; conventional power is 80 %.
    trims : share of what trims of unseen flights differ by that wind or ground must explain: more than half.
    slipped : part of the square of all equations' steps that the deflection of one control must make, for the steps to
        be that control's; in other people's simulators 0.99 of the control that slipped, of others at most 0.47.
    tilt : share of the square of a measured angle that goes with a description, for the cause to lie in that angle: a
        controller may hold the disc where it was, and then no angle goes with what acts.
    effects : undeclared effects that may join, at most.
    fits : candidates that are fitted in full side by side, those of largest evidence first; others where none stands.
    """

    level: float = 0.05
    confidence: float = 0.90
    adequate: float = 0.5
    draws: int = 19
    earliest: int = 9
    exceeding: int = 1
    missed: float = 0.2
    trims: float = 0.5
    slipped: float = 0.9
    tilt: float = 0.2
    effects: int = 4
    fits: int = 5


SETTINGS = Settings()
"""The settings of every search."""
