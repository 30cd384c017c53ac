"""What records hold: `repeated`, `steps`, `copies`, `stamps`, `vibration`; `excitation`, `coherence`, `answers`."""
