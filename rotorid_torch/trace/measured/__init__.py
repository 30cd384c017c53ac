"""Candidates scored by accelerations at measured states, where a free run means little: multirotors.

`fitted` (a model by least squares, and how it compares with another), `measured_family` (candidates beside it),
`accelerations` (the two as what a search goes by).
"""
