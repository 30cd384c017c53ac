"""Flights with something hidden in them. Read `drawn_aircraft`, `outside_causes`, `wakes`, then `in_records`.

`true_parameters` says what a hidden effect is in the library's parameters; `changed_records` puts other
records into a data set.
"""
