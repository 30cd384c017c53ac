"""Sensors against each other by exact kinematics: which are late, slow, off scale, turned, displaced or biased.

`kinematic_findings` leads through it: `pieces` (of flights), `weighted_fit` and `normal_equations` (least squares in
the frequency domain), `selection` (which errors the data need), `constants` (what all flights share), `drift` (gyros
within a flight). `clocks` joins all clocks in one verdict, `sensor_finding` and `sensor_words` say it.
"""
