"""Sensor errors taken out of records: what is left is what a sensor without error reads."""

import numpy as np
import pytest

from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.consistency.examination.check import check
from rotorid_torch.consistency.sensor_errors.kinematic_findings import kinematic_findings
from tests.consistency.sensor_errors.kinematic_cases import data

INNER = slice(30, -30)
CHANNELS = ("u", "v", "w", "p", "q", "r", "phi", "theta", "psi", "ax", "ay", "az")


@pytest.mark.parametrize(
    ("errors", "tolerance"),
    [
        ({"delay.attitude": 0.0637}, 1e-4),
        ({"delay.velocities": -0.05}, 1e-3),
        ({"filter.velocities": 0.05}, 4e-2),
        ({"filter.rates_period": 0.05, "filter.rates_damping": 0.6}, 4e-2),
        ({"scale.q": 0.05, "bias.q": 0.01}, 1e-6),
        ({"misalignment.y": 0.035, "misalignment.z": -0.02}, 1e-6),
        ({"lever_arm.x": 0.4, "lever_arm.z": -0.3}, 2e-2),
    ],
)
def test_records_without_noise_return_to_what_is_true(errors: dict[str, float], tolerance: float) -> None:
    true, wrong = data({}, 0, flights=1, noise=1e-9), data(errors, 0, flights=1, noise=1e-9)
    repaired = without_errors(wrong, errors)
    for name, values in true.flights["f0"].channels.items():
        exact, got = values[INNER].numpy(), repaired.flights["f0"].channels[name][INNER].numpy()
        assert np.abs(got - exact).max() < tolerance, name
    assert any(
        np.abs((wrong.flights["f0"].channels[c] - true.flights["f0"].channels[c]).numpy()[INNER]).max() > 2 * tolerance
        for c in true.flights["f0"].channels
    )


def test_a_moved_clock_leaves_its_end_missing_and_gaps_where_they_are() -> None:
    late = data({"delay.attitude": 0.05}, 0, flights=1)
    late.flights["f0"].channels["p"][100:110] = np.nan
    phi = without_errors(late, {"delay.attitude": 0.05}).flights["f0"].channels["phi"]
    assert not phi[:-6].isnan().any()
    assert phi[-5:].isnan().all()
    assert without_errors(late, {"scale.p": 0.1}).flights["f0"].channels["p"][100:110].isnan().all()


def test_undoing_a_lag_at_most_doubles_the_noise_power() -> None:
    noisy, clean = data({}, 0, flights=1), data({}, 0, flights=1, noise=1e-9)
    lag = {"filter.velocities": 0.05}
    a, b = (without_errors(d, lag).flights["f0"].channels["u"][INNER] for d in (noisy, clean))
    assert 1.0 < float((a - b).std()) / 0.05 < 1.5
    assert without_errors(noisy, lag).noise("u") == pytest.approx(0.05 * np.sqrt(2.0))


def test_what_was_found_is_gone_after_correction() -> None:
    dataset = data({"delay.attitude": 0.06, "scale.q": 0.04}, 2, flights=5)
    found = kinematic_findings(dataset)
    assert set(found.effects) == {"sensors.delay", "sensors.scale"}
    assert kinematic_findings(found.corrected(dataset)).effects == ()


def test_a_vector_of_which_an_axis_is_missing_is_not_turned_with_a_zero() -> None:
    turned = data({"misalignment.y": 0.3}, 0, flights=1, keep=[c for c in CHANNELS if c != "ay"])
    channels = without_errors(turned, {"misalignment.y": 0.3}).flights["f0"].channels
    assert channels["ax"].isnan().all()
    assert channels["az"].isnan().all()
    assert not channels["p"].isnan().any()
    kept = without_errors(turned, {"scale.ax": 0.1}).flights["f0"].channels["ax"]
    assert not kept.isnan().any()


def test_a_turned_unit_without_an_axis_is_known_by_its_rates_alone() -> None:
    turned = data({"misalignment.y": 0.3}, 0, flights=4, keep=[c for c in CHANNELS if c != "ay"])
    said = [f for f in check(turned).findings if f.severity == "error"]
    assert any("turned by 17" in f.sentence for f in said)
    assert any(f.channel == "ax az" and "cannot be turned back" in f.sentence for f in said)
    found = kinematic_findings(turned)
    assert set(found.effects) == {"sensors.misalignment"}
    straight = data({}, 0, flights=4, keep=[c for c in CHANNELS if c != "ay"])
    assert kinematic_findings(straight).effects == ()
