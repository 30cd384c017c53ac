"""What single records hold: `steps` and `copies`, `stamps`, lines of `vibration`, `excitation` and `coherence`."""
