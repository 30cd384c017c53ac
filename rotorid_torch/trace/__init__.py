"""What the model lacks, and which named effect explains it: sensors against each other first, then forces and moments.

`loop` is the whole of it for trajectories, `multirotor` for accelerations at measured states. `terms/` are candidates,
findings and all numbers that decide; `evidence/` compares models with one effect more, `measured/` the same at measured
states; `search/` selects, decides and words; `sensors/` does the same for sensors by exact kinematics. `clean_aircraft`
flies the null, `air` feeds gusts in. Beside the search: `balance` (where thrusts balance), `stochastic` (gusts and
vibration), `network` (what no name explains, learnt).
"""
