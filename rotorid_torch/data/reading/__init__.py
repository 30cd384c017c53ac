"""From a flight's file to a flight: what is no data is refused, what is no sample of the motion is left out.

In the order of the way: `npz` and `read` (arrays as they lie on disk), `marks` (values that stand for a missing
sample), `spikes` (lone wild samples), `held` (stretches without new samples), `grid` (one uniform time grid),
`suspicion` (degrees where radians belong), `dead` (channels that stand still), `noise` (white noise of a channel; the
time before the controls move). Then `contents` (declaration and flights together) and `sources` (a folder, or arrays
in memory).
"""
