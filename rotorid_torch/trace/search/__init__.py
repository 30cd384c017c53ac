"""The search: which candidates join, what each is worth, and in which words it is said.

`eligible` (what can be tested), `screening_sizes` and `ordinary_physics` come before it; `forward_selection` is the
search, `trajectories` one residual that it scores candidates by, `outcome` how it ended and what is said of each
effect; `decide` is the one table, `words` say it; `by_control` and `localisation` look closer; `requested` asks
whether effects that a user named earn their place.
"""
