"""Flights as other tools take them: `pictures` (matplotlib), `tables` (pandas), `windows` (a DataLoader of torch)."""
