"""The identification model: an ordered chain of stages with one parameter vector.

Read `model` (the chain) and `nominal` (which chain a vehicle's data support); then its parts: `linear_equations` (about
the reference; flapping is a block of them), `derivatives` (forces and moments), `inflow` (the main rotor's; the tail
rotor's stands in `derivatives`), `rotors` (a multirotor's), and `gusts` (the same model in moving air). `own_effects`
tries what a user's effect promises. `modes` and `accelerations` are what a model says at a point, `save` is model.pt.
`training/`: free runs with gradients.
"""
