"""Physical effects that can step into the model's chain, one class each.

Read `base` (what an effect is), `spec` (what a model is built from) and `reference` (where it rests), then any file of
`families/`. `registry` holds them by id, with those of other packages; `weights` takes those of torch modules into the
parameters; `testable` says why a data set cannot test an effect; `signal_operations` (delay, lag, rate limit, play of a
record) serve effects before and after the time loop; `momentum` is the inflow of all rotors; `examples` are two
vehicles for the table of effects.
"""
