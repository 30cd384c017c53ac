"""The three steps: reconstruct (UKF), regress (FTR), output error (ML)."""
