"""Sensors, controls and clocks of a data set against each other, before any model is made.

Kinematics needs no aerodynamics: what disagrees is a sensor, a unit or a clock. `equations` says how sensors err,
`correction` takes errors out, `conventions` are other ways to write an attitude, `smoothing` is the form in which
records are compared, `sensor_pairs` two records that kinematics makes one, `imu_place` where the IMU is, which pairs
are given. Then `pairs/` (two records against each other), `records/` (what each holds), `sensor_errors/` (all errors of
sensors jointly, for `check` and `close-loop` alike); `examination/` says the result in sentences and grades.
"""
