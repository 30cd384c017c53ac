"""From fields of a log to signals in SI, whatever the format.

`streams` (what a reader gives), `mapping` (the user's map from fields to channels) and `plan` (the built-in ones),
`units`, `outputs` (what a motor or servo output means), `fields` (a clean clock, impossible samples out), `derive`
(channels from what logs hold instead), `resets` (steps of an estimator), `boots` (clocks that begin again).
"""
