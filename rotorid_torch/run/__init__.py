"""A run: the order of the steps, and what a command leaves behind.

Read `pipeline` first: it alone knows the order of `identify`; `result` is what comes out.
`close_loop` traces what the model lacks, adds it and identifies again (`free_runs` says which model is better);
`check` examines a data set, `saved_model` flies a model again. `fit_record` and `loop_record` turn models and findings
into records of the report; `turbulence` is what moving air does to findings and scores. `output/` is the folder that
all of them write.
"""
