"""Work elsewhere: `ranks` (processes that share a run), `children` (processes that end with this one), `device`."""
