"""Work elsewhere: `ranks` share a run, `pool` carries out requests in `children`, which end with this process.

`loading` of imports, `memory`, `device` beside them.
"""
