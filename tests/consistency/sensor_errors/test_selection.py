"""Errors that differ from flight to flight, by linear equations of few flights; filters whose damping shows little."""

import numpy as np
import pytest

from rotorid_torch.consistency.sensor_errors.normal_equations import Normal, Point, Search
from rotorid_torch.consistency.sensor_errors.pieces import pieces
from rotorid_torch.consistency.sensor_errors.selection import STEADY, Case, inside, joined, spread
from rotorid_torch.consistency.sensor_errors.weighted_fit import Setting
from rotorid_torch.core.statistics import student_quantile, variance_between, weighted_mean
from rotorid_torch.effects.families.sensors import DAMPED, PERIOD
from tests.consistency.sensor_errors.kinematic_cases import GRAVITY, data

TURN, TILT = "misalignment.y", "bias.theta"
NAMES = (TURN, TILT)


def columns(rng: np.random.Generator) -> list[np.ndarray]:
    """White rows (200, 2) of seven flights; one shows the tilt most, others tell a turn of the IMU from the tilt."""
    shows = np.array([[0.2, 0.1], [3.0, 0.1], [0.1, 0.2], [0.5, 4.0], [0.2, 0.1], [0.5, 0.6], [2.0, 1.0]])
    mixed = np.array([[1.0, 0.7], [0.0, 0.7]])
    return [(rng.standard_normal((200, 2)) @ mixed) * one for one in shows]


def fitted(rows: list[np.ndarray], left: list[np.ndarray]) -> Point:
    """The normal equations at the least sum of squares of |left + rows step|^2, both errors common to all flights."""
    matrix = sum(x.T @ x for x in rows)
    step = -np.linalg.solve(matrix, sum(x.T @ y for x, y in zip(rows, left, strict=True)))
    left = [y + x @ step for x, y in zip(rows, left, strict=True)]
    parts = tuple(
        Normal(f"f{k}", x.T @ x, x.T @ y, float(y @ y), {}) for k, (x, y) in enumerate(zip(rows, left, strict=True))
    )
    gradient = np.sum([part.gradient for part in parts], axis=0)
    return Point(dict(zip(NAMES, step, strict=True)), NAMES, parts, matrix, gradient, sum(p.cost for p in parts))


def flown(rng: np.random.Generator, mean: float, between: float) -> Point:
    """Flights with a tilt of their own each, about this mean."""
    rows = columns(rng)
    tilts = mean + between * rng.standard_normal(len(rows))
    return fitted(rows, [rng.standard_normal(len(x)) - x[:, 1] * tilt for x, tilt in zip(rows, tilts, strict=True)])


def test_the_mean_over_flights_is_that_of_generalised_least_squares() -> None:
    rng = np.random.default_rng(0)
    rows = columns(rng)
    left = [rng.standard_normal(len(x)) - x[:, 1] * tilt for x, tilt in zip(rows, rng.standard_normal(7), strict=True)]
    found = spread(fitted(rows, left), TILT, NAMES)
    # one column for the turn and one for the tilt of each flight
    whole = np.zeros((7 * 200, 8))
    for k, x in enumerate(rows):
        whole[200 * k : 200 * (k + 1), [0, k + 1]] = x
    covariance = np.linalg.inv(whole.T @ whole)
    each = -(covariance @ whole.T @ np.concatenate(left))[1:]
    covariance, one = covariance[1:, 1:], np.ones(7)
    weight = np.linalg.inv(covariance)
    about = each - one @ weight @ each / weight.sum()
    expected = np.trace(weight) - one @ weight @ weight @ one / weight.sum()
    weight = np.linalg.inv(covariance + max(0.0, (about @ weight @ about - 6) / expected) * np.eye(7))
    assert found.mean == pytest.approx(one @ weight @ each / weight.sum())
    assert found.value == pytest.approx(weight.sum() ** -0.5)


def test_of_flights_without_common_errors_it_is_the_mean_with_their_variance() -> None:
    point = flown(np.random.default_rng(1), 0.0, 1.0)
    steps = [(-p.gradient[1] / p.matrix[1, 1], p.matrix[1, 1] ** -0.5) for p in point.parts]
    values, errors = np.array(steps).T
    mean, error = weighted_mean(values, np.hypot(errors, variance_between(values, errors) ** 0.5))
    found = spread(point, TILT, (TILT,))
    assert found.mean - point.errors[TILT] == pytest.approx(mean)
    assert found.value == pytest.approx(error)


@pytest.mark.parametrize("between", [0.0, 0.3, 1.0])
def test_tilts_about_none_are_no_error_of_all_flights(between: float) -> None:
    rng, named = np.random.default_rng(2), 0
    for _ in range(1000):
        found = spread(flown(rng, 0.0, between), TILT, NAMES)
        named += abs(found.mean) > student_quantile(STEADY, found.flights - 1.0) * found.value
    assert named <= 10  # 2.7 of 1000 are due


def test_a_tilt_of_all_flights_stands_out_of_what_each_has() -> None:
    rng = np.random.default_rng(3)
    found = [spread(flown(rng, 10.0, 0.3), TILT, NAMES) for _ in range(100)]
    clear = [abs(one.mean) > student_quantile(STEADY, one.flights - 1.0) * one.value for one in found]
    assert sum(clear) > 90


def test_a_filter_whose_damping_the_flights_do_not_tell_is_weighed_with_the_usual_one() -> None:
    # motion below 1.5 Hz shows a delay of such a filter alone, and noise takes the damping to the end of its range
    dataset = data({f"filter.accelerations{PERIOD}": 1.0 / 60.0}, 1, flights=5)
    name, damping = f"filter.accelerations{PERIOD}", f"filter.accelerations{DAMPED}"
    search = Search(pieces(dataset), Setting(GRAVITY, np.zeros(3)))
    begin = search.measure({}, (name, damping))
    assert not inside(name, search.fit(search.fit({}, (name,)).errors, (name, damping)))
    fit = joined(Case(dataset, search, (name, damping), 15.0), begin, (), name)
    assert inside(name, fit)
    assert fit.errors[name] == pytest.approx(1.0 / 60.0, rel=0.1)
