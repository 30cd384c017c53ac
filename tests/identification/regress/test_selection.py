"""Structure selection, bands and diagnostics on systems whose structure is known, and on algebraic flapping."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from rotorid_torch.errors import InputError
from rotorid_torch.identification.regress.equation import Equation, choose_band, fit_equation
from rotorid_torch.identification.regress.ftr import regress
from rotorid_torch.identification.regress.selection import beyond, redundant, response_lag, select
from tests.helpers import shared
from tests.identification.regress.known_systems import NOISE, ROLL_PITCH_YAW, flights, noisy

DT = 1.0 / 154.0
NAMES = ("p", "q", "r", "lat", "lon")


def equation(state: int = 0, level: float = 1.0, count: int = 4, **changes: object) -> Equation:
    """One state equation of the known system with noise on everything."""
    runs = [r[0] for r in noisy(flights(ROLL_PITCH_YAW, [15.0] * count, DT), level * NOISE, 1, seed=state)]
    noise = level * NOISE
    plain = Equation("rates", [r[:, state] for r in runs], runs, NAMES, DT, "derivative", float(noise[state]), noise)
    return replace(plain, **changes)  # pyright: ignore[reportArgumentType]


def with_extra(base: Equation, extra: list[Tensor], name: str, noise: float) -> Equation:
    """Append one candidate regressor."""
    regressors = [torch.cat((x, e.unsqueeze(-1)), dim=-1) for x, e in zip(base.regressors, extra, strict=True)]
    known = torch.as_tensor(base.regressor_noise)
    return replace(
        base,
        regressors=regressors,
        names=(*base.names, name),
        regressor_noise=torch.cat((known, known.new_tensor([noise]))),
    )


def wander(seed: int, samples: int = 2311) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return 0.002 * torch.randn(samples, generator=generator, dtype=torch.float64).cumsum(0)


def test_fit_equation_is_regress_with_names() -> None:
    e = equation(band=(0.2, 1.9))
    result = fit_equation(e, ("q", "lon"))
    columns = [x[:, [1, 4]] for x in e.regressors]
    same = regress(e.response, columns, DT, (0.2, 1.9), noise=NOISE[[1, 4]])
    assert torch.allclose(result.coefficients, same.coefficients)
    assert torch.allclose(result.covariance, same.covariance)
    assert result.selected == ("q", "lon")
    with pytest.raises(InputError, match="no regressor 'x'"):
        fit_equation(e, ("x",))


def test_selection_holds_what_is_there_and_leaves_out_what_is_not() -> None:
    e = equation()
    for k in range(3):
        e = with_extra(e, [wander(10 * k + f) for f in range(4)], f"wander{k}", 0.0)
    result = select(e)
    assert result.selected == NAMES
    assert set(result.reasons or {}) == {"wander0", "wander1", "wander2"}
    assert all("flights left out" in reason for reason in (result.reasons or {}).values())
    assert ((result.coefficients - ROLL_PITCH_YAW.row(0)).abs() < 4.0 * result.standard_errors).all()


def test_forced_regressors_stay() -> None:
    e = with_extra(equation(), [wander(f) for f in range(4)], "wander", 0.0)
    assert "wander" in select(e, forced=("wander",)).selected


def test_one_flight_is_judged_by_predicted_squared_error() -> None:
    result = select(equation(count=1))
    assert result.selected == NAMES
    assert result.r2 > 0.98


def test_flapping_that_only_repeats_its_drivers_is_redundant_and_barred() -> None:
    base = equation(state=1)
    generator = torch.Generator().manual_seed(3)
    clean = flights(ROLL_PITCH_YAW, [15.0] * 4, DT)
    mix = torch.tensor([0.02, -0.08, 0.0, 0.1, 0.9], dtype=torch.float64)
    sensed = [x @ mix + 0.001 * torch.randn(len(x), generator=generator, dtype=torch.float64) for x in clean]
    e = with_extra(base, sensed, "a1", 0.001)
    (found,) = beyond(e, ("a1",), NAMES)
    assert found.share < 0.01
    assert found.reliability < 0.5
    assert found.sigma < 3.0
    assert found.gains["lon"] == pytest.approx(0.9, abs=0.02)
    assert redundant(e, ("a1",), NAMES) == ["a1"]
    result = select(e, driven=("a1",))
    assert result.selected == NAMES
    assert (result.reasons or {})["a1"] == "carries nothing reliable beyond what drives it"
    assert ((result.coefficients - ROLL_PITCH_YAW.row(1)).abs() < 4.0 * result.standard_errors).all()
    # and with all of them held the noise still does not run away with the fit
    assert fit_equation(e).coefficients.abs().max() < 100.0


def test_feedback_shows_in_the_share_of_a_control() -> None:
    clean = flights(ROLL_PITCH_YAW, [15.0] * 4, DT)
    fed_back = [(x @ torch.tensor([0.1, 0.3, 0.0, 0.0, 0.0], dtype=torch.float64)) + 0.05 * x[:, 3] for x in clean]
    (found,) = beyond(with_extra(equation(), fed_back, "sas", 0.0), ("sas",), ("p", "q", "r"))
    assert found.share < 0.05
    assert found.gains["q"] == pytest.approx(0.3, abs=0.05)


def test_lag_of_a_response_is_found_and_none_where_it_is_algebraic() -> None:
    clean = flights(ROLL_PITCH_YAW, [15.0] * 4, DT)
    mix = torch.tensor([0.02, -0.08, 0.0, 0.1, 0.9], dtype=torch.float64)
    generator = torch.Generator().manual_seed(4)
    base = equation(kind="value", response_noise=0.001)
    for tau, bound in ((0.0, 0.004), (0.08, 0.008)):
        responses = []
        for x in clean:
            response, follow = torch.zeros(len(x), dtype=torch.float64), x @ mix
            response[0] = follow[0]
            decay = torch.exp(torch.tensor(-DT / max(tau, 1e-9)))
            for k in range(1, len(x)):
                middle = 0.5 * (follow[k] + follow[k - 1])
                response[k] = follow[k] if tau == 0.0 else middle + (response[k - 1] - middle) * decay
            responses.append(response + 0.001 * torch.randn(len(x), generator=generator, dtype=torch.float64))
        lag, error = response_lag(replace(base, response=responses))
        assert lag == pytest.approx(tau, abs=bound)
        assert error < 0.004


def test_prior_holds_where_the_data_are_silent_and_yields_where_they_speak() -> None:
    e = with_extra(equation(), [torch.zeros(2311, dtype=torch.float64)] * 4, "silent", 0.0)
    mean = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 7.0], dtype=torch.float64)
    free = fit_equation(equation())
    loose = fit_equation(replace(e, prior_mean=mean, prior_sd=torch.full((6,), 100.0, dtype=torch.float64)))
    assert torch.allclose(loose.coefficients[:5], free.coefficients, atol=1e-3)
    assert float(loose.coefficients[5]) == pytest.approx(7.0)
    assert float(loose.standard_errors[5]) == pytest.approx(100.0, rel=1e-6)
    tight = fit_equation(replace(e, prior_mean=mean, prior_sd=[torch.inf] * 3 + [1e-6] * 3))
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


@pytest.mark.parametrize(("name", "algebraic"), [("ah1-hover", True), ("uh60-hover", False)])
def test_measured_like_flapping_is_told_apart(name: str, algebraic: bool) -> None:
    from rotorid_torch.data.dataset import load

    data = load(shared("flightdata", name))
    drivers = ("u", "v", "w", "p", "q", "r", "lon", "lat", "col", "ped")
    names = (*drivers, "a0", "a1", "b1")
    selected = [data.flights[f] for f in data.identify]
    noise = [data.noise(n) for n in names]
    roll = Equation("L", [f.channels["p"] for f in selected], [f.stack(names) for f in selected], names, selected[0].dt)
    roll = replace(roll, response_noise=data.noise("p"), regressor_noise=noise)
    flapping = replace(
        roll,
        response=[f.channels["a1"] for f in selected],
        regressors=[f.stack(drivers) for f in selected],
        names=drivers,
        kind="value",
        response_noise=data.noise("a1"),
        regressor_noise=noise[:10],
    )
    lag, _ = response_lag(flapping)
    assert (lag < 2.0 * selected[0].dt) == algebraic
    assert redundant(replace(roll, band=(0.13, 2.0)), ("a0", "a1", "b1"), drivers) == (["a0", "a1", "b1"] * algebraic)
    result = select(roll, driven=("a0", "a1", "b1"))
    assert ("b1" in result.selected) != algebraic
    assert result.r2 > 0.95
    assert result.residual_ratio < 2.0
    damping = float(result.coefficients[result.selected.index("p")])
    assert damping < 0.0
