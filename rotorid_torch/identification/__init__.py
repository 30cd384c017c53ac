"""The three steps: what acted on the aircraft, regression of it, maximum likelihood.

`reconstruct/` is step 1 (unscented filter: motion, forces and moments in SI), `regress/` step 2 (Fourier transform
regression) and `estimate/` step 3 (output error), each on anybody's arrays; `filter_error/` is step 3 where the air
moves. On the package's model: `structure` (which model the data support), `mixer` (where rotors stand whose places are
not declared), `model_regression` and `rotor_regression` (step 2; `rotor_equations` and `measured_states` are what the
latter solves), `model_estimation` (step 3); `method_choice` says whether by output error or by filter error, `gusts`
how the air moved, and feeds it in. `arguments` is what estimators on anybody's model take, checked; `own_model` stands
between such a model and the records (delays, angles).
"""
