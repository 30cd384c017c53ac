"""The identification model: an ordered chain of stages with one parameter vector."""
