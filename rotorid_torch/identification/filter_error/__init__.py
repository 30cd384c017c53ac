"""Step 3 where the air moves: the filter error method, maximum likelihood with process noise.

Read `method` first, then `search` and `result`. `extended_kalman` is the filter with its derivatives, `innovations` the
likelihood, `held_gain` the form for large models, `start` its beginning, `smoother` and `covariance` its end.
"""
