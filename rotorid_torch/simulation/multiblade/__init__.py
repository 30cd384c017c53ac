"""A batch of different helicopters, rotors in multi-blade coordinates: trim is a point, a linear model a difference.

`craft` (numbers and states), `dynamics` (Kane's equations of body, shaft, flap and lag) with `airframe`, `trim`
(equilibria and linear models), `priors` (how widely each number is drawn).
"""
