"""A run: the order of the steps, its folder, its report, its monitor."""
