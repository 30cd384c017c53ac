"""What every chapter stands on: names, parameters, states, rigid body, time loop; no data set, no effect, no model.

`names` (channels, controls, units) and `ranges` (what an aircraft can be), `parameters` and `state` (flat vectors with
names), `rigid` (kinematics and equations of motion), `integrate` (the time loop), `recursion` and `table` (memories and
look-up inside a model), `least_squares` and `gauss_newton` (bounded searches), `statistics` (quantiles, jackknife,
autocorrelation). `native/` is the fast engine, `storage/` files and memory, `processes/` processes and devices.
"""
