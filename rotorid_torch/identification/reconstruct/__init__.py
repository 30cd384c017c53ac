"""Step 1: forces and moments that acted, and the flight's channels without noise, from whatever channels a flight has.

`reconstruction` leads through it. `motion` is the filter's model, `observability` says which of its states the channels
tell; `force_noise` with `gauss_markov` finds power and bandwidth of the forces, `sensor_biases` what sensors add. The
filter itself, for any functions: `filter_problem`, `sigma_points`, `unscented_filter`, `iterated` (constants learnt).
"""
