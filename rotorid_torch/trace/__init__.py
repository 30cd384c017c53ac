"""Which named effect explains what the model does not: sensors against each other first, then forces and moments."""
