"""Tables as logs.

`csv` (with `header`: where the table begins) and `arrays` (NPZ, MATLAB, Parquet) read; `columns` finds the clock and
the units; `sidpac` is the built-in map of SIDPAC's `fdata`.
"""
