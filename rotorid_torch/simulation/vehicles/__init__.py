"""Vehicle files: `vehicle_file` is their form, `vehicle` builds the aircraft, `uh60.toml` is the one built in."""
