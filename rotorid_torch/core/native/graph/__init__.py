"""From a torch function to C++: in the order of the way.

`tracing` runs the function once; `rules` and `small_systems` say what torch's operations do to `symbols`, whose
`operations` have a value, derivatives and C++ each; `derivatives` linearises, `emit` writes.
"""
