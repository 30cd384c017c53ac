"""The time loop: order and agreement of step, simulate and step_jacobian with SciPy and autograd."""

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from torch import Tensor
from torch.func import jacrev

from rotorid_torch.core.integrate import simulate, step, step_jacobian, step_stages


def pendulum(t: Tensor, x: Tensor, u: Tensor) -> Tensor:
    return torch.stack([x[..., 1], -4.0 * torch.sin(x[..., 0]) - 0.3 * x[..., 1] + u[..., 0] + 0.1 * torch.sin(t)], -1)


def record(samples: int, dt: float) -> Tensor:
    return torch.sin(3.0 * dt * torch.arange(samples, dtype=torch.float64))[:, None]


def test_agrees_with_an_adaptive_method_to_fourth_order() -> None:
    x0, errors = torch.tensor([0.5, -0.2], dtype=torch.float64), []
    for samples in (81, 161):
        dt = 4.0 / (samples - 1)
        times, controls = dt * np.arange(samples), record(samples, dt)
        drive = np.interp

        def rates(t: float, x: np.ndarray, times=times, controls=controls, drive=drive) -> list[float]:
            u = drive(t, times, controls[:, 0].numpy())
            return [x[1], -4.0 * np.sin(x[0]) - 0.3 * x[1] + u + 0.1 * np.sin(t)]

        truth = solve_ivp(rates, (0.0, 4.0), x0.numpy(), t_eval=times, rtol=1e-11, atol=1e-12, max_step=dt).y.T
        errors.append(float(np.abs(simulate(pendulum, x0, controls, dt).numpy() - truth).max()))
    assert errors[1] < 2e-7
    assert errors[0] / errors[1] > 12.0


def test_simulate_repeats_step() -> None:
    dt, controls = 0.05, record(40, 0.05)
    x = torch.tensor([0.3, 0.0], dtype=torch.float64)
    rows = [x]
    for k in range(39):
        t = torch.tensor(k * dt, dtype=torch.float64)
        rows.append(step(pendulum, t, rows[-1], controls[k], controls[k + 1], dt))
    torch.testing.assert_close(simulate(pendulum, x, controls, dt), torch.stack(rows), rtol=1e-12, atol=1e-13)


def test_a_batch_is_its_rows() -> None:
    x0 = torch.randn(3, 1, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    controls = torch.randn(2, 30, 1, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    batch = simulate(pendulum, x0, controls, 0.02)
    assert batch.shape == (3, 2, 30, 2)
    torch.testing.assert_close(batch[1, 1], simulate(pendulum, x0[1, 0], controls[1], 0.02), rtol=1e-12, atol=1e-14)


def test_one_sample_is_the_initial_state() -> None:
    x0 = torch.ones(2, dtype=torch.float64)
    assert torch.equal(simulate(pendulum, x0, torch.zeros(1, 1, dtype=torch.float64), 0.1), x0[None])


@pytest.mark.parametrize("solver", ["dopri5", "midpoint"])
def test_other_methods_of_torchdiffeq(solver: str) -> None:
    controls, x0 = record(200, 0.01), torch.tensor([0.3, 0.0], dtype=torch.float64)
    reference = simulate(pendulum, x0, controls, 0.01)
    torch.testing.assert_close(simulate(pendulum, x0, controls, 0.01, solver=solver), reference, rtol=0, atol=2e-4)


def test_derivative_of_a_step_is_exact() -> None:
    generator = torch.Generator().manual_seed(2)
    x, gain = torch.randn(5, 2, generator=generator, dtype=torch.float64), torch.tensor(0.7, dtype=torch.float64)
    u0, u1 = torch.randn(2, 5, 1, generator=generator, dtype=torch.float64)
    t, dt = torch.zeros(5, dtype=torch.float64), 0.1

    def driven(gain: Tensor):
        return lambda t, x, u: pendulum(t, x, gain * u)

    _, stages = step_stages(driven(gain), t, x, u0, u1, dt)
    by_state = torch.zeros(4, 5, 2, 2, dtype=torch.float64)
    by_state[..., 0, 1], by_state[..., 1, 1] = 1.0, -0.3
    by_state[..., 1, 0] = -4.0 * torch.cos(stages[..., 0])
    by_gain = torch.zeros(4, 5, 2, 1, dtype=torch.float64)
    by_gain[..., 1, 0] = torch.stack([u0 + c * (u1 - u0) for c in (0.0, 1 / 3, 2 / 3, 1.0)])[..., 0]
    transition, gamma = step_jacobian(by_state, by_gain, dt)
    whole = jacrev(lambda x, g: step(driven(g), t, x, u0, u1, dt), argnums=(0, 1))(x, gain)
    torch.testing.assert_close(transition, torch.stack([whole[0][i, :, i] for i in range(5)]), rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(gamma[..., 0], whole[1], rtol=1e-12, atol=1e-14)
