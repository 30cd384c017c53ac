"""Work elsewhere: `ranks` share a run, `pool` carries out requests in `children`, which end with this process.

`beside` makes a result in a fork of this process; `loading` is how a process begins, `device` where its tensors lie.
"""
