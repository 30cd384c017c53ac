"""Flights as other tools take them: `pictures` (matplotlib), `tables` (pandas)."""
