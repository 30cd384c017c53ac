"""A run in plain words: what was discovered, how good the model is, what to do next.

`effects` holds what each effect means to whoever flies the vehicle, and what to do about it; `sizes` writes values with
errors in units that people use; `verdict` makes the first sentence and the steps of a report; `glossary` says what each
word of the report means.
"""
