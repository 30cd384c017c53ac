"""The fast engine: a torch model traced once, written as C++, compiled, and run inside a few generic loops.

`graph/` leads from torch to C++; `build` compiles and keeps libraries; `dynamics`, `adjoint`, `filtering`,
`innovations`, `observer`, `points` and `recurrences` are what Python calls, each with its loop in `loops/`;
`side_by_side` is torch's algebra in threads.
"""
