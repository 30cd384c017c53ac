"""Logs in: from files of autopilots and tables to a data set.

`logs` is `rotorid import` from reading to the lists of flights; `formats` says which reader takes which file; `flights`
makes one log flights, through `resample` (one time grid) and `manoeuvres` (cuts); `frames` is what of the vehicle is
left to fill in. `signals/` holds what all formats share, from a field of a log to a channel in SI; `autopilots/` and
`tables/` hold one file per format.
"""
