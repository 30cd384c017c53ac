"""Step 2: one equation after the other, by least squares on finite Fourier transforms.

`fourier` (transforms of sampled records), `rows` (one flight as rows), `noisy_least_squares` (regressors with noise),
`feedback` (whether a residual acts back on regressors), `ftr` (the regression, for anybody's arrays), `equation` (an
equation of the model as data).
"""
