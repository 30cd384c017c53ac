"""Step 3 where the air moves: the filter error method, maximum likelihood with process noise.

Read `method` first, then `search` (from the start to the maximum) and `result` (with its covariance). `extended_kalman`
is the filter with its derivatives, `innovations` the likelihood, `held_gain` the form for large models, `smoother` what
whole flights say of the states.
"""
