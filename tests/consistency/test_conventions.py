"""Other ways to write an attitude or rates: each is told as that, and nothing else is; right records are left alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rotorid_torch.consistency.conventions import OF_ANGLES, ORDERS, convention, in_usual_convention
from rotorid_torch.consistency.examination.check import check
from rotorid_torch.consistency.pairs.alignment import body_rates
from rotorid_torch.consistency.sensor_errors.clocks import sensor_findings
from rotorid_torch.core import names
from rotorid_torch.data import Dataset
from rotorid_torch.data.one_rate import at_one_rate
from tests.consistency.examination.test_check import placed

Arrays = dict[str, np.ndarray]


def written(flight: Arrays, form: str) -> Arrays:
    """The flight with its attitude by another order of turns, or with rates of its angles."""
    angles = np.stack([flight[name] for name in names.ATTITUDES], axis=1)
    if form == OF_ANGLES:
        p, q, r = (flight[name] for name in names.RATES)
        phi, theta, _ = angles.T
        turning = (q * np.sin(phi) + r * np.cos(phi)) / np.cos(theta)
        return flight | {"p": p + turning * np.sin(theta), "q": q * np.cos(phi) - r * np.sin(phi), "r": turning}
    turned = Rotation.from_euler("ZYX", angles[:, ::-1]).as_euler(form)
    order = [form.index(axis) for axis in "XYZ"]
    return flight | dict(zip(names.ATTITUDES, np.unwrap(turned[:, order], axis=0).T, strict=True))


def dataset(form: str) -> Dataset:
    flights = {f"f{seed}": placed(seed) for seed in range(3)}
    return Dataset.from_arrays({name: written(f, form) for name, f in flights.items()}, identify=list(flights))


@pytest.mark.parametrize("form", [*ORDERS, OF_ANGLES])
def test_another_convention_is_named_and_nothing_else(form: str):
    data = dataset(form)
    found = convention(data)
    assert found is not None
    assert found.form == form
    usual = in_usual_convention(data, found)
    for seed in range(3):
        flight = placed(seed)
        for name in (*names.RATES, *names.ATTITUDES):
            away = usual.flights[f"f{seed}"][name].numpy() - flight[name]
            assert np.nanmax(np.abs(away - np.round(away / (2 * np.pi)) * 2 * np.pi)) < 1e-9
    told = [
        f for f in check(data).findings if f.severity in ("warning", "error") and "nowhere follow" not in f.sentence
    ]
    assert sensor_findings(at_one_rate(data)).effects == ()
    assert [f.channel for f in told] == ["p q r" if form == OF_ANGLES else "phi theta psi"]


def test_right_records_and_turned_sensors_are_in_the_usual_convention():
    flights = {f"f{seed}": placed(seed) for seed in range(3)}
    assert convention(Dataset.from_arrays(flights, identify=list(flights))) is None
    for flight in flights.values():
        p, q = flight["p"], flight["q"]
        flight["p"], flight["q"] = 0.9 * p + 0.436 * q, 0.9 * q - 0.436 * p
    assert convention(Dataset.from_arrays(flights, identify=list(flights))) is None


def test_body_rates_are_those_of_the_rotation():
    chance, dt = np.random.default_rng(0), 1e-4
    for order in ("ZYX", *ORDERS):
        angles, changes = chance.uniform(-1.0, 1.0, (2, 3))
        places = ["XYZ".index(axis) for axis in order]
        before, after = (Rotation.from_euler(order, (angles + k * dt * changes)[places]) for k in (-0.5, 0.5))
        turned = (before.inv() * after).as_rotvec() / dt
        assert np.abs(body_rates(angles[None], changes[None], order)[0] - turned).max() < 1e-6
