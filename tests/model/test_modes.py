"""Modes: eigenvalues of a known matrix, and the field's names for them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.optimize import fsolve

from rotorid_torch.model.modes import gust_response, modes, settled_derivatives, state_matrix
from tests.known_models import BODY, DERIVATIVES, helicopter, linear_vehicle

G = 9.80665


def known_matrix() -> np.ndarray:
    """dx/dt = A x of `linear_vehicle` in level hover."""
    A = np.zeros((8, 8))
    A[0, [0, 4, 7]] = -0.05, 0.4, -G
    A[1, [1, 3, 6]] = -0.1, -0.4, G
    A[2, 2] = -0.5
    A[3, [1, 3, 4]] = -0.03, -3.0, -0.6
    A[4, [0, 3, 4]] = 0.01, 0.2, -2.0
    A[5, [1, 5]] = 0.02, -0.8
    A[6, 3] = A[7, 4] = 1.0
    return A


def test_state_matrix_and_eigenvalues_are_those_of_the_derivatives():
    model = linear_vehicle()
    np.testing.assert_allclose(state_matrix(model).numpy(), known_matrix(), atol=1e-12)
    wanted = [v for v in np.linalg.eigvals(known_matrix()) if v.imag >= 0]
    found = modes(model, {})
    assert [abs(m.eigenvalue) for m in found] == sorted(abs(m.eigenvalue) for m in found)
    np.testing.assert_allclose([m.eigenvalue for m in found], sorted(wanted, key=abs), atol=1e-9)


def test_names_are_the_field_s():
    sizes = dict(zip(BODY, (3.0, 3.0, 2.0, 0.2, 0.2, 0.2, 0.2, 0.2), strict=True))
    found = {m.name: m.eigenvalue for m in modes(linear_vehicle(), sizes)}
    assert found["heave subsidence"] == pytest.approx(-0.5)
    assert found["yaw subsidence"] == pytest.approx(-0.8)
    assert found["roll subsidence"].real == pytest.approx(-2.9, abs=0.1)
    assert found["pitch subsidence"].real == pytest.approx(-2.0, abs=0.2)
    assert found["phugoid"].imag > 0
    assert found["lateral oscillation"].imag > 0


def test_a_longitudinal_oscillation_is_named_by_its_states_not_by_its_frequency():
    """Phugoid: speed and pitch attitude; short period: vertical speed and pitch rate (Etkin and Reid, sec. 6.3)."""
    model = linear_vehicle()
    values = {f"forces.{row}.{by}": 0.0 for row in "XYZLMN" for by in BODY}
    values |= {"forces.X.u": -0.02, "forces.Z.w": -0.4, "forces.Z.q": 20.0}
    values |= {"forces.M.w": -0.02, "forces.M.q": -0.4, "forces.M.u": 1e-4}
    model.start_from({name: value for name, value in values.items() if name in model.parameter_set})
    found = {m.name: abs(m.eigenvalue) for m in modes(model, {}) if m.eigenvalue.imag > 0.0}
    assert found["short period"] == pytest.approx(0.75, abs=0.05)
    assert found["phugoid"] < 0.2


def test_units_of_the_states_do_not_change_modes():
    model = linear_vehicle()
    found = [modes(model, sizes) for sizes in ({}, {"u": 100.0, "p": 1e-3})]
    for a, b in zip(*found, strict=True):
        assert a.eigenvalue == pytest.approx(b.eigenvalue, abs=1e-9)


def test_rotor_and_inflow_have_their_names():
    names = [m.name for m in modes(helicopter(), {})]
    assert "flapping" in names
    assert "inflow" in names


def test_reference_point_is_the_model_s():
    model = helicopter()
    x, u = model.reference_point
    assert x.dtype == u.dtype == torch.float64
    assert x[: len(BODY)].tolist() == [model.reference[n] for n in BODY]
    assert u.tolist() == [model.reference[n] for n in model.body.controls]


def test_gusts_shake_the_accelerometers_by_the_derivatives_where_there_is_no_rotor():
    found = gust_response(linear_vehicle(imu=(0.0, 0.0, 0.0)))
    assert found == pytest.approx({"ax": 0.05, "ay": 0.1, "az": 0.5}, abs=1e-9)


def test_gusts_shake_the_accelerometers_when_the_rotor_has_settled():
    """Against a run with the body held in the gust."""
    model = helicopter()
    found, (x, u) = gust_response(model), model.reference_point
    n, theta, gust, dt = len(model.body.states), model.theta.detach(), 1e-3, 5e-3
    for axis, channel in zip(("u", "v", "w"), ("ax", "ay", "az"), strict=True):
        ends = []
        for sign in (-1.0, 1.0):
            now = x.clone()
            now[model.layout.names.index(axis)] += sign * gust
            for _ in range(800):
                now[n:] += dt * model.rates(theta, now, u)[n:].detach()
            ends.append(model.outputs_at(theta, now, u)[model.body.outputs.index(channel)])
        assert found[channel] == pytest.approx(abs(float(ends[1] - ends[0])) / (2.0 * gust), rel=5e-3)


def test_derivatives_of_a_vehicle_without_a_rotor_are_its_parameters():
    found = {d.name: d.value for d in settled_derivatives(linear_vehicle())}
    assert found == pytest.approx({name: value for name, value in DERIVATIVES.items() if value}, abs=1e-9)


@torch.no_grad()
def test_derivatives_with_the_rotor_settled_are_those_of_forces_where_its_rates_vanish():
    model = helicopter()
    found, (x, u) = {d.name: d.value for d in settled_derivatives(model)}, model.reference_point
    n, theta, step, names = len(model.body.states), model.theta.detach(), 1e-5, model.layout.names
    at_reference = model.rates(theta, x, u)[n:]

    def forces(body: torch.Tensor, sticks: torch.Tensor) -> np.ndarray:
        whole = lambda rotor: torch.cat([body[:n], torch.as_tensor(rotor)])  # noqa: E731
        rest = lambda rotor: (model.rates(theta, whole(rotor), sticks)[n:] - at_reference).numpy()  # noqa: E731
        settled = fsolve(rest, x[n:].numpy(), xtol=1e-12)
        frame = model.frame(theta, whole(settled), sticks)[0]
        return np.concatenate([part.numpy() for part in (frame.force, frame.moment) if part is not None])

    for name in (*names[:6], *model.body.controls):
        ends = []
        for sign in (-1.0, 1.0):
            body, sticks = x.clone(), u.clone()
            held, order = (sticks, model.body.controls) if name in model.body.controls else (body, names)
            held[order.index(name)] += sign * step
            ends.append(forces(body, sticks))
        for row, value in zip("XYZLMN", (ends[1] - ends[0]) / (2.0 * step), strict=True):
            assert found.get(f"{row}.{name}", 0.0) == pytest.approx(value, rel=1e-4, abs=1e-4)


def test_errors_of_settled_derivatives_are_those_of_drawn_parameters():
    model, draws = helicopter(), 100
    names = [n for n in model.parameter_set.free if n.startswith(("forces.L", "forces.M", "rotor."))]
    places = [model.parameter_set.index(n) for n in names]
    root = torch.tensor(np.random.default_rng(0).normal(size=(len(names), len(names))), dtype=torch.float64)
    size = 1e-3 * (model.theta.detach()[places].abs() + 0.01)
    root = size[:, None] * root / root.norm(dim=1, keepdim=True)
    found = {d.name: d.se for d in settled_derivatives(model, names, root @ root.mT)}
    few = {}
    with model.restored():
        at = model.theta.detach().clone()
        for k in range(draws):
            moved = at.clone()
            moved[places] += root @ torch.tensor(np.random.default_rng(k).normal(size=len(names)), dtype=torch.float64)
            model.put(moved)
            for d in settled_derivatives(model):
                few.setdefault(d.name, []).append(d.value)
    for name in ("L.p", "M.q", "L.lat", "M.lon"):
        assert found[name] == pytest.approx(float(np.std(few[name])), rel=0.25)
