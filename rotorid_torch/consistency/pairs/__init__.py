"""Two records against each other, by the lag at which they agree best.

The two records are those of `consistency.sensor_pairs`. Read `alignment` first (turned sensors, far clocks),
`far_lags` (far clocks without exact kinematics), `clock_rate` (a lag that grows), `time_base` (one factor on all axes),
`drawn_attitude` (no attitude but the accelerometers'), `odd_flights` (what is wrong in some flights), `signs`, `axes`
(and units), `velocity_clock`, `precedence` and `late_controls` (a response never comes before its control).
"""
