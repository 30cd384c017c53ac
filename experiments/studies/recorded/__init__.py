"""Runs of a study that goes on where it stopped: `lines` of the record, `runs` that add them, `tables` made of them."""
