"""Step 3: output error, maximum likelihood of simulated segments, for any module with forward and output.

Read `output_error` first. `system` makes a module a function of its free parameters, `segments` cuts flights,
`sensitivity` simulates and differentiates, `engine` does it in torch or native code; `residuals` holds their
covariance and tests it for colour. `likelihood` puts them together, `initial_states` starts it, `progressive_fit` goes
from short segments to long ones by `core.gauss_newton` or `lbfgs`; `uncertainty` says how far to trust the result.
`own_models/` is what models that are not the package's own need besides.
"""
