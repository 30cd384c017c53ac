"""Standard errors: exact under known colour, equal to Cramer-Rao when white, the jackknife where flights disagree."""

import math

import numpy as np
import pytest
import torch

from rotorid_torch.core.storage import mapped_arrays
from rotorid_torch.identification.estimate import likelihood, uncertainty
from rotorid_torch.identification.estimate.output_error import OutputError, output_error
from rotorid_torch.identification.estimate.segments import cut, records_from
from rotorid_torch.identification.estimate.sensitivity import sensitivities, simulated
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.identification.estimate.uncertainty import lines_of
from tests.identification.estimate.output_error_cases import ROLL, Roll, roll_flight

SD = np.array([0.01, 0.02])
WHOLE = [math.inf]


def fitted(flights: list[dict[str, object]]) -> OutputError:
    return output_error(Roll(), flights, segment_lengths=WHOLE)


def exact_covariance(flights: list[dict[str, object]], colour: float) -> torch.Tensor:
    """Covariance of the estimate that weights as if white, the noise being first-order autoregressive."""
    records = records_from(flights)
    segments = cut(records, records.samples)
    system = System(Roll())
    run = simulated(system, system.theta, records, segments, torch.zeros(len(segments), 2, dtype=torch.float64))
    slopes = torch.cat([b.outputs for b in sensitivities(system, run, records, segments)]).transpose(0, 1)
    white = slopes / torch.tensor(SD)[:, None]
    k = torch.arange(records.samples, dtype=torch.float64)
    correlation = colour ** (k[:, None] - k).abs() if colour else torch.eye(len(k), dtype=torch.float64)
    information, middle = torch.zeros(3, 3, dtype=torch.float64), torch.zeros(3, 3, dtype=torch.float64)
    for piece in white:
        rows = piece.flatten(0, 1)
        freed = rows[:, 2:] - rows[:, :2] @ torch.linalg.lstsq(rows[:, :2], rows[:, 2:]).solution
        information += freed.mT @ freed
        per_output = freed.unflatten(0, (records.samples, 2))
        middle += torch.einsum("kcn,kl,lcm->nm", per_output, correlation, per_output)
    inverse = torch.linalg.inv(information)
    return inverse @ middle @ inverse


def test_errors_under_known_colour() -> None:
    for colour, tolerance in ((0.0, 0.2), (0.95, 0.3)):
        ratios = []
        for run in range(4):
            rng = np.random.default_rng(100 + run)
            flights = [roll_flight(rng, colour=colour, shift=0.5 * k) for k in range(2)]
            truth = exact_covariance(flights, colour).diagonal().sqrt()
            found = fitted(flights)
            ratios.append(torch.tensor([p.se for p in found.parameters]) / truth)
            if colour:
                assert bool((found.uncertainty.cramer_rao.diagonal().sqrt() < 0.5 * truth).all())
            else:
                torch.testing.assert_close(found.uncertainty.cramer_rao.diagonal().sqrt(), truth, rtol=0.15, atol=0)
        mean = torch.stack(ratios).mean(0)
        assert float((mean - 1.0).abs().max()) < tolerance, (colour, mean)


def test_transforms_have_lengths_that_are_quick() -> None:
    assert [lines_of(n) for n in (1, 3, 6, 257, 513)] == [2, 6, 12, 540, 1080]


def test_many_flights_in_parts_and_on_disk_give_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    flights = [roll_flight(rng, shift=0.1 * k) for k in range(6)]
    whole = fitted(flights)
    monkeypatch.setattr(mapped_arrays, "LARGE", 0)
    monkeypatch.setattr(likelihood, "PART_NUMBERS", 1)
    monkeypatch.setattr(likelihood, "KEPT_NUMBERS", 0)
    monkeypatch.setattr(uncertainty, "KEPT_NUMBERS", 0)
    monkeypatch.setattr(likelihood, "SOLVED", 4)
    parts = fitted(flights)
    torch.testing.assert_close(
        torch.tensor([(p.value, p.se) for p in parts.parameters]),
        torch.tensor([(p.value, p.se) for p in whole.parameters]),
        rtol=1e-10,
        atol=1e-12,
    )


def test_the_jackknife_counts_where_flights_disagree() -> None:
    rng = np.random.default_rng(0)
    flights = [roll_flight(rng, shift=0.3 * k) for k in range(5)]
    same = fitted(flights)
    for k, flight in enumerate(flights):  # control power differs from flight to flight
        flight["controls"] = np.asarray(flight["controls"]) * (1.0 + 0.1 * (k - 2))
    apart = fitted(flights)
    plain = same.uncertainty.coloured.diagonal().sqrt()
    assert bool((torch.tensor([p.se for p in same.parameters]) < 2.0 * plain).all())
    power = apart.parameters[2]
    assert abs(power.se**2 / float(apart.uncertainty.jackknife[2]) - 1.0) < 1e-9
    assert power.se > 3.0 * float(apart.uncertainty.cramer_rao[2, 2].sqrt())
    assert abs(power.value - ROLL[2]) < 4.0 * power.se
    torch.testing.assert_close(apart.covariance.diagonal().sqrt()[2], torch.tensor(power.se, dtype=torch.float64))


def test_one_step_jackknife_is_refitting_without_the_flight() -> None:
    rng = np.random.default_rng(1)
    flights = [roll_flight(rng, shift=0.3 * k) for k in range(4)]
    estimates = []
    for left_out in range(4):
        rest = fitted([f for k, f in enumerate(flights) if k != left_out])
        estimates.append(torch.tensor([p.value for p in rest.parameters], dtype=torch.float64))
    moved = torch.stack(estimates)
    variances = 3 / 4 * (moved - moved.mean(0)).square().sum(0)
    torch.testing.assert_close(fitted(flights).uncertainty.jackknife, variances, rtol=0.1, atol=0)


def test_two_flights_are_too_few_for_a_jackknife() -> None:
    rng = np.random.default_rng(2)
    found = fitted([roll_flight(rng), roll_flight(rng)])
    assert bool(found.uncertainty.jackknife.isnan().all())
    assert all(math.isfinite(p.se) and p.se > 0 for p in found.parameters)
