"""Velocities where a data set holds none.

`source` says where they can come from: `positions` (motion capture, trackers on the ground) or, by an IMU alone,
`dead_reckoning`.
"""
