"""Clean data sets of helicopters like the one that a data set is about: the null of every search.

`resemblance` (trim and derivatives of the data set, as the drawn aircraft shall have them), `draws` (randomised maximum
likelihood over the priors), `tracking` (the drawn aircraft follow the measured flights), `data_sets` (the three in
order). Multirotors: `multirotor_draws` (vehicles of one frame), `multirotors` (they follow the measured flights).
"""
