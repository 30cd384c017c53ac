"""Sensors, controls and clocks of a data set against each other, before any model is made.

Kinematics needs no aerodynamics: what disagrees is a sensor, a unit or a clock. Read `sensor_pairs` first (two records
that kinematics makes one), then `alignment` (turned sensors, far clocks), `velocity_clock`, `precedence` and
`late_controls` (a response never comes before its control), then what the records hold: `steps`, `copies`, `stamps`,
`vibration`, `excitation`, `coherence`. `sensor_errors/` estimates all errors of sensors jointly, for `check` and
`close-loop` alike; `examination/` says the result in sentences and grades.
"""
