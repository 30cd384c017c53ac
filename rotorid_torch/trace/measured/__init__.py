"""Candidates scored by accelerations at measured states, where a free run means little: multirotors.

`fitted` (a model by least squares, and how it compares with another), `left_over` (what it leaves without a name),
`measured_family` (candidates beside it), `accelerations` (these as what a search goes by).
"""
