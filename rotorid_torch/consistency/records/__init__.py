"""What single records hold: `steps`, `copies`, `stamps`, `vibration`, `excitation`, `coherence` and `answers`."""
