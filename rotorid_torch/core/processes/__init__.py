"""Work elsewhere: `ranks` share a run, `pool` carries out requests in `children`, which end with this process.

`forks` make results while this process goes on; `loading` is how a process begins, `device` where its tensors lie.
"""
