"""The identification model: an ordered chain of stages with one parameter vector.

Read `model` (the chain) and `nominal` (which chain a vehicle's data support); then its parts: `derivatives` and
`linear_equations` (forces and moments about the reference), `flapping`, `inflow` (the main rotor's; the tail rotor's
stands in `derivatives`), `rotors` (a multirotor's), and `gusts` (the same model in moving air).
`modes` and `accelerations` are what it says at a point, `save` is model.pt. `training/`: free runs with gradients.
"""
