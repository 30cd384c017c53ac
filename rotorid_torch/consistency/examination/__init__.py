"""What `rotorid check` says of a data set: findings in words of flight test, each with what to do, and a grade.

`check` runs the examinations in order; each yields a `finding`: `needs` (what every step asks for), `samples` and
`records` (each channel by itself), `breaks` (steps, copies), `kinematics` and `surroundings` (channels against each
other, gravity, wind), `controls` and `band` (what can be identified). `grade` sums the findings up by axis.
"""
