"""What no named effect explains, learnt by a small network (`close-loop --hybrid`); no name for it.

`network` (the network, its training on equations, and whether it stays), `trajectories` (beside a model that is fitted
to trajectories), `accelerations` (beside one of a multirotor, at measured states). Flights, fits of the null and unseen
flights are those of `trace`, which knows of no network.
"""
