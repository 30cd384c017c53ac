"""What `rotorid check` says of a data set: findings in words of flight test, each with what to do, and a grade.

`check` runs the examinations in order; each yields a `finding`: `needs` (what every step asks for), `samples` and
`records` (each channel by itself, steps and copies), `kinematics`, `frames` and `surroundings` (channels against each
other, axes and units, gravity, wind), `controls` (what can be identified) and `acting` (which does what). `grade` sums
them up by axis.
"""
