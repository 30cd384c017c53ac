"""Free runs and scores."""
