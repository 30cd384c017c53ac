"""The effects that come with the package, one file per family.

In the order of the model's chain: `control`, `environment`, `main_rotor` and `rotor_speed`, `propulsion`, `airframe`
and `neural` (forces), `mass`, `sensors`.
"""
