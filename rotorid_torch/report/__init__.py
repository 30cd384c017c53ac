"""The report: what a run found, as records, words, pictures and a page.

`records` is report.json, field by field. `summary` and `short_horizon` say it in few words, `remarks` and `limits` what
a user must know besides; `words/` puts discoveries into plain sentences; `scorecard` is the console's view, `page/` the
page; `overlay` is what pictures of a run show, `figures`, `loop_figures` and `check_figures` draw.
"""
