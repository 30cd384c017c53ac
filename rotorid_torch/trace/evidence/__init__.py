"""Evidence for a candidate: how much better unseen flights are predicted with it.

`fits` and `parallel_fits` (models that are compared, fitted with one care), `screen` (all candidates at once by one
step), `held_out` (the statistic), `force_evidence` (the same from forces on the measured motion), `residual`
and `unattributed` (what has no name), `family` (all of it, for the data and for each draw), `critical_values` (p);
`trim_differences` (what flights differ by at their start).
"""
