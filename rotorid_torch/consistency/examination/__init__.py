"""What `rotorid check` says of a data set: findings in words of flight test, each with what to do, and a grade.

`check` runs the examinations in order; each yields a `finding`: `needs` (what every step asks for), `samples` and
`records` (each channel by itself), `breaks` (steps, copies), `kinematics`, `frames` and `surroundings` (channels
against each other, axes and units, gravity, wind), `controls` (what can be identified). `grade` sums them up by axis.
"""
