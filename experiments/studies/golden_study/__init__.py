"""The golden study: its `cases`, one `closed_loop` as a line, the `table` of all lines."""
