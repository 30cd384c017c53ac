"""Logs of autopilots, read by own code and mapped by their makers' names.

`ulog` and `dataflash` read binary logs block by block (`blocks`), `dataflash_text` the latter as text. `px4` (with
`px4_motors` and `px4_odometry`), `ardupilot` and `blackbox` are the built-in maps from their fields to channels.
"""
