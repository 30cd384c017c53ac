"""The folder of a run: whole or absent.

`folder` (written beside its place, renamed when complete), `checkpoint` (finished steps, for a run that goes on),
`monitor` with `board` and `curves` (console, log.txt, TensorBoard), `write` (report and pictures); `arguments` checks
what functions of runs take.
"""
