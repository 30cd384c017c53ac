"""What records hold: `repeated`, `steps`, `clock_steps`, `copies`, `stamps`, `vibration`.

And what controls did: `excitation`, `coherence`, `answers`.
"""
