"""Equations of systems whose structure is known: bands, priors, and what regressors carry beyond others."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from rotorid_torch.identification.regress.equation import Equation, choose_band, fit_equation, independent_shares
from rotorid_torch.identification.regress.ftr import regress
from tests.identification.regress.known_systems import NOISE, ROLL_PITCH_YAW, flights, noisy

DT = 1.0 / 154.0
NAMES = ("p", "q", "r", "lat", "lon")


def equation(state: int = 0, level: float = 1.0, count: int = 4, **changes: object) -> Equation:
    """One state equation of the known system with noise on everything."""
    runs = [r[0] for r in noisy(flights(ROLL_PITCH_YAW, [15.0] * count, DT), level * NOISE, 1, seed=state)]
    noise = level * NOISE
    responses = [r[:, state] for r in runs]
    own = float(noise[state])
    plain = Equation("rates", responses, runs, NAMES, [DT] * count, "derivative", noise.tolist(), own)
    return replace(plain, **changes)  # pyright: ignore[reportArgumentType]


def with_extra(base: Equation, extra: list[Tensor], name: str, noise: float) -> Equation:
    """Append one candidate regressor."""
    regressors = [torch.cat((x, e.unsqueeze(-1)), dim=-1) for x, e in zip(base.regressors, extra, strict=True)]
    declared = [*base.regressor_noise, noise]
    return replace(base, regressors=regressors, names=(*base.names, name), regressor_noise=declared)


def test_fit_equation_is_regress_with_names() -> None:
    e = equation(band=(0.2, 1.9))
    result = fit_equation(e, ("q", "lon"))
    columns = [x[:, [1, 4]] for x in e.regressors]
    same = regress(e.response, columns, DT, (0.2, 1.9), noise=NOISE[[1, 4]], trend=False)
    assert torch.allclose(result.coefficients, same.coefficients)
    assert torch.allclose(result.covariance, same.covariance)
    assert result.selected == ("q", "lon")


def test_flapping_that_only_repeats_its_drivers_carries_nothing_beyond_them() -> None:
    base = equation(state=1)
    generator = torch.Generator().manual_seed(3)
    clean = flights(ROLL_PITCH_YAW, [15.0] * 4, DT)
    mix = torch.tensor([0.02, -0.08, 0.0, 0.1, 0.9], dtype=torch.float64)
    sensed = [x @ mix + 0.001 * torch.randn(len(x), generator=generator, dtype=torch.float64) for x in clean]
    e = with_extra(base, sensed, "a1", 0.001)
    assert independent_shares(e, ("a1",), NAMES)["a1"] < 0.01
    # with all of them held the noise still does not run away with the fit
    assert fit_equation(e).coefficients.abs().max() < 100.0


def test_feedback_shows_in_the_share_of_a_control() -> None:
    clean = flights(ROLL_PITCH_YAW, [15.0] * 4, DT)
    fed_back = [(x @ torch.tensor([0.1, 0.3, 0.0, 0.0, 0.0], dtype=torch.float64)) + 0.05 * x[:, 3] for x in clean]
    e = with_extra(equation(), fed_back, "sas", 0.0)
    shares = independent_shares(e, ("sas", "lat"), ("p", "q", "r"))
    assert shares["sas"] < 0.05
    assert shares["lat"] > 0.5


def test_prior_holds_where_the_data_are_silent_and_yields_where_they_speak() -> None:
    e = with_extra(equation(), [torch.zeros(2311, dtype=torch.float64)] * 4, "silent", 0.0)
    mean = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 7.0], dtype=torch.float64)
    free = fit_equation(equation())
    loose = fit_equation(replace(e, prior=(mean, torch.full((6,), 100.0, dtype=torch.float64))))
    assert torch.allclose(loose.coefficients[:5], free.coefficients, atol=1e-3)
    assert float(loose.coefficients[5]) == pytest.approx(7.0)
    assert float(loose.standard_errors[5]) == pytest.approx(100.0, rel=1e-6)
    tight = fit_equation(replace(e, prior=(mean, torch.tensor([torch.inf] * 3 + [1e-6] * 3, dtype=torch.float64))))
    assert torch.allclose(tight.coefficients[3:], mean[3:], atol=1e-3)


def test_band_ends_where_noise_or_dynamics_end_the_equation() -> None:
    quiet, loud = choose_band(equation()), choose_band(equation(level=10.0))
    assert quiet[0] == pytest.approx(2.0 / 15.0)
    assert quiet[1] > loud[1] > 1.7  # the controls move up to 1.8 Hz
    late = equation(kind="value")
    shift = round(0.15 / DT)
    delayed = [
        torch.cat((y[:1].expand(shift), y[:-shift])) for y in (x @ ROLL_PITCH_YAW.row(0) for x in late.regressors)
    ]
    assert choose_band(replace(late, response=delayed))[1] < quiet[1]
