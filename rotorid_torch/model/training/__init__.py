"""What torch's optimisers need of a model: free runs with gradients, and parameters by name.

`equilibrium` (where the effects' own states rest) and `trajectories` (the engines) carry `free_run`, which cuts
windows out of flights; `named_parameters` are the parameter vector as torch's optimisers take it.
`measured_motion` lets effects' own states follow a motion that was measured.
"""
