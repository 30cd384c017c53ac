"""How the aircraft flies: from its parts to sampled channels.

`motion` (rates of the states) and `runge_kutta` (the time loop), `trim` and `linear` (equilibrium and derivatives),
`augmentation` and `manoeuvres` (what steers), `simulation` (a batch of flights), `hidden_signals` and `sensors` (what
is written of them).
"""
