"""What the model lacks, and which named effect explains it, in forces, moments and their controls.

`loop` is the whole of it, for trajectories and for accelerations at measured states. `terms/` are candidates,
findings and all numbers that decide; `evidence/` compares models with one effect more, `measured/` the same at measured
states; `search/` selects, decides and words. `clean_aircraft` flies the null (in processes of
`__main__`), `air` feeds gusts in. Beside the search:
`balance` (where thrusts balance), `stochastic` (gusts and vibration). Errors of sensors are a chapter of
`consistency/`; what stays without a name is learnt in `learning/`.
"""
