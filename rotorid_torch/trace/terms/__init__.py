"""The terms of tracing: plain data and the numbers that decide.

`settings` (every number, with its reason), `significance` (what is more than chance), `candidate` (what is
tested), `finding` and `verdict` (what is said of one effect, and of a run).
"""
