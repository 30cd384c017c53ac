"""What records hold: `repeated`, `steps`, `clock_steps`, `copies`, `stamps`, `vibration`, `slow`, `ground`.

And what controls did: `excitation`, `coherence`, `answers`.
"""
