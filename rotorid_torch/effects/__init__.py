"""Physical effects that can step into the model's chain, one class each."""
