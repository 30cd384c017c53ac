"""Velocities from position and attitude: exact on cubics, as noisy as told, and enough to identify from."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from rotorid_torch.core import rigid
from rotorid_torch.core.names import ATTITUDES, POSITIONS, RATES, VELOCITIES
from rotorid_torch.data import Dataset
from rotorid_torch.data.velocities import with_velocities

DT = 0.01
NOISE = 0.002
TIME = DT * np.arange(600)


def data(position: np.ndarray, attitude: np.ndarray, **more: np.ndarray) -> Dataset:
    still = {c: 0.01 * np.sin((k + 1) * TIME) for k, c in enumerate(("lat", *RATES))}
    named = {**dict(zip(POSITIONS, position, strict=True)), **dict(zip(ATTITUDES, attitude, strict=True))}
    told = {c: {"noise": NOISE} for c in POSITIONS}
    return Dataset.from_arrays({"f": {"time": TIME, **still, **named, **more}}, identify=["f"], channels=told)


def turning() -> np.ndarray:
    return np.stack([0.3 * np.sin(TIME), 0.2 * np.cos(2.0 * TIME), 0.5 * TIME])


def test_a_cubic_path_gives_its_velocity_exactly():
    path = np.stack([TIME**3 / 40.0, 2.0 * TIME - TIME**2, 1.0 + 0.5 * TIME])
    got = with_velocities(data(path, turning())).flights["f"]
    back = rigid.position_rates(got.stack(VELOCITIES), got.stack(ATTITUDES))[15:-15]
    exact = np.stack([3.0 * TIME**2 / 40.0, 2.0 - 2.0 * TIME, 0.5 + 0.0 * TIME], axis=-1)[15:-15]
    torch.testing.assert_close(back, torch.from_numpy(exact), rtol=0.0, atol=1e-9)
    assert bool(got.channels["u"][:15].isnan().all())


def test_the_noise_is_that_of_the_record_and_no_score_knows_the_channels():
    noise = NOISE * np.random.default_rng(3).standard_normal((3, len(TIME)))
    seen = with_velocities(data(np.stack([TIME, TIME, TIME]) + noise, 1e-9 * turning()))
    for channel, level in zip(VELOCITIES, (1.0, 1.0, -1.0), strict=True):
        away = seen.flights["f"].channels[channel][15:-15] - level
        assert float(away.std()) == pytest.approx(seen.noise(channel), rel=0.2)
    assert set(seen.scored()).isdisjoint(VELOCITIES)
    assert "not measured" in seen.warnings[-1]


def test_axes_that_are_not_known_better_count_at_speed_and_a_long_way_does_not():
    rng = np.random.default_rng(5)
    path = np.stack([20.0 * TIME, 0.0 * TIME, 0.0 * TIME]) + 0.003 * rng.standard_normal((3, len(TIME)))
    attitude = 0.01 * rng.standard_normal((3, len(TIME)))
    named = {**dict(zip(POSITIONS, path, strict=True)), **dict(zip(ATTITUDES, attitude, strict=True))}
    rates = {c: 0.01 * np.sin(TIME) for c in ("lat", *RATES)}
    raw = Dataset.from_arrays({"f": {"time": TIME, **rates, **named}}, identify=["f"])
    made = with_velocities(raw)
    v = made.flights["f"].channels["v"][15:-15]
    assert float(v.std()) == pytest.approx(made.noise("v"), rel=0.3)


def test_a_missing_position_leaves_a_gap_and_nothing_else():
    path = np.stack([TIME, 2.0 * TIME, 1e-9 * TIME])
    path[0, 300] = np.nan
    u = with_velocities(data(path, 1e-9 * turning())).flights["f"].channels["u"]
    assert bool(u[285:316].isnan().all())
    torch.testing.assert_close(u[316:500], torch.ones_like(u[316:500]))


def test_what_was_measured_or_cannot_be_made_stays_as_it_is():
    path = np.stack([TIME, TIME, TIME])
    measured = data(path, turning(), w=np.sin(TIME))
    assert with_velocities(measured) is measured
    no_heading = data(path, np.stack([*turning()[:2], np.full_like(TIME, np.nan)]))
    assert with_velocities(no_heading) is no_heading
    held = with_velocities(data(np.repeat(path[:, ::20], 20, axis=1), turning()))
    assert "held or missing" in held.warnings[-1]
    assert with_velocities(held).warnings == held.warnings
    assert with_velocities(data(0.0 * path, turning())).derived == frozenset()  # a position that never changes is dead
    hovering = 0.001 * np.round(20.0 * np.stack([np.sin(TIME)] * 3))  # motion capture to a millimetre
    assert with_velocities(data(hovering, turning())).derived == {"u", "v", "w"}
    gaps = path.copy()
    gaps[:, ::10] = np.nan
    assert "u" not in with_velocities(data(gaps, turning())).flights["f"].channels
    assert "u" not in held.flights["f"].channels
