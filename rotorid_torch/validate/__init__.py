"""How a model is judged: free runs from the first second on, and scores.

`free_run` and `windows` (8 s from every whole second), `scores` (J and its yardsticks, pure functions); for multirotors
`responses` and `predictions` (accelerations and parts of a second at measured states; `judged` holds them), over
`lists` of flights, `rotor_moments` (what rotors do not explain is held at zero) and `declared_vehicle` (whether mass,
arms and inertia can be). `gusts` judges free runs in moving air, `neighbours` are a model drawn from its errors, and
without an effect.
"""
