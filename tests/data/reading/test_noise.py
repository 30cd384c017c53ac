"""The noise estimator against known noise under coloured motion, edges, lines and gaps, and against declarations."""

import numpy as np
import pytest

from rotorid_torch.data import load
from rotorid_torch.data.reading.noise import white_noise
from tests.helpers import shared, shared_sets

DT = 1 / 154.0


def motion(samples, rng):
    """Motion of a body: white noise through three lags near 1 Hz."""
    values = rng.standard_normal(samples)
    for _ in range(3):
        pole = np.exp(-2 * np.pi * 1.0 * DT)
        for k in range(1, samples):
            values[k] += pole * (values[k - 1] - values[k])
    return values / values.std()


@pytest.mark.parametrize("share", [0.3, 0.03, 0.003])
def test_white_noise_under_coloured_motion(share):
    rng = np.random.default_rng(3)
    records = [motion(2311, rng) + share * rng.standard_normal(2311) for _ in range(8)]
    assert white_noise(records) == pytest.approx(share, rel=0.1)


def test_edges_of_a_control_do_not_count():
    rng = np.random.default_rng(4)
    time = DT * np.arange(2311)
    edges = 0.05 * sum(np.where(time > at, sign, 0.0) for at, sign in [(1, 1), (4, -2), (6, 2), (7, -2), (8, 1)])
    records = [edges + 0.0005 * rng.standard_normal(2311) for _ in range(2)]
    assert white_noise(records) == pytest.approx(0.0005, rel=0.15)


def test_vibration_line_in_the_band_does_not_count():
    rng = np.random.default_rng(5)
    line = 0.2 * np.sin(2 * np.pi * 55.0 * DT * np.arange(2311))
    assert white_noise([line + 0.01 * rng.standard_normal(2311) for _ in range(4)]) == pytest.approx(0.01, rel=0.15)


def test_missing_samples_leave_their_segments_out():
    rng = np.random.default_rng(6)
    record = 0.01 * rng.standard_normal(4000)
    record[500:520] = np.nan
    assert white_noise([record]) == pytest.approx(0.01, rel=0.12)


def test_too_short_is_not_a_number():
    assert np.isnan(white_noise([np.zeros(10)]))
    assert np.isnan(white_noise([]))


@pytest.mark.parametrize("name", [name for name in shared_sets() if name.startswith(("uh60", "ah1"))])
def test_estimates_agree_with_declarations(name):
    dataset = load(shared("flightdata", name))
    specs = {**dataset.control_specs, **dataset.channel_specs}
    for channel, spec in specs.items():
        records = [dataset.flights[flight].channels[channel].numpy() for flight in dataset.identify]
        assert white_noise(records) == pytest.approx(spec.noise, rel=0.08), channel
