"""Native trajectories, sensitivities and normal equations against the reference engine, torchdiffeq and autograd."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torchdiffeq import odeint

from rotorid_torch.core import integrate
from rotorid_torch.core.native.dynamics import Dynamics, LinearProblem
from rotorid_torch.core.native.graph import emit
from rotorid_torch.core.table import lookup

DT, NX, NU, NY, COUNT = 0.02, 5, 2, 4, 7
PATH = (5, 2)


def draw(seed: int, *shape: int) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


class Lag(torch.nn.Module):
    """An effect with a state of its own: the stick reaches the rotor late, through a table of its gain."""

    def forward(self, lag: Tensor, stick: Tensor, theta: Tensor) -> Tensor:
        knots, gains = torch.tensor([-1.0, 0.0, 2.0]).double(), torch.tensor([0.5, 1.0, 1.2]).double()
        return theta[..., 4] * (stick * lookup(stick, knots, gains) - lag)


class Model(torch.nn.Module):
    """A body of four states, u and w in m/s, q in rad/s, attitude; a lag; and a network that adds to its moment."""

    def __init__(self) -> None:
        super().__init__()
        self.lag = Lag()
        self.network = torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.Tanh(), torch.nn.Linear(4, 1)).double()
        for k, weight in enumerate(self.network.parameters()):
            weight.data = 0.3 * draw(30 + k, *weight.shape)
        self.requires_grad_(False)

    def forces(self, x: Tensor, u: Tensor, theta: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        speed = torch.linalg.vector_norm(x[..., :2], dim=-1)
        X = theta[..., 0] * x[..., 0] - theta[..., 3] * speed * x[..., 0]
        Z = theta[..., 1] * x[..., 1] + theta[..., 6] * u[..., 1]
        moment = theta[..., 2] * x[..., 2] + theta[..., 5].exp() * x[..., 4] + self.network(x[..., :3])[..., 0]
        return X, Z, moment

    def rates(self, x: Tensor, u: Tensor, theta: Tensor) -> Tensor:
        X, Z, moment = self.forces(x, u, theta)
        attitude, q = x[..., 3], x[..., 2]
        du = X - x[..., 1] * q - 9.81 * attitude.sin()
        dw = Z + x[..., 0] * q + 9.81 * (attitude.cos() - 1.0)
        return torch.stack([du, dw, moment, q, self.lag(x[..., 4], u[..., 0], theta)], dim=-1)

    def outputs(self, x: Tensor, u: Tensor, theta: Tensor) -> Tensor:
        X, Z, _ = self.forces(x, u, theta)
        return torch.stack([X, Z + 0.1 * x[..., 2], x[..., 2], x[..., 3] * (1.0 + theta[..., 6])], dim=-1)

    def motion(self, x: Tensor, u: Tensor, theta: Tensor) -> tuple[Tensor, Tensor]:
        return self.rates(x, u, theta), self.outputs(x, u, theta)


MODEL = Model()
THETA = torch.tensor([-0.3, -0.8, -1.5, 0.05, 4.0, 0.4, -0.6], dtype=torch.float64)


def dynamics(**settings: object) -> Dynamics:
    return replace(Dynamics.of(MODEL.motion, draw(1, NX), draw(2, NU), THETA + 0.1), **settings)


def sticks(flights: int, samples: int) -> Tensor:
    return draw(3, flights, samples, NU).cumsum(dim=1) * 0.1


def starts(flights: int) -> Tensor:
    return 0.3 * draw(4, flights, NX)


def reference(x0: Tensor, controls: Tensor, theta: Tensor = THETA) -> tuple[Tensor, Tensor]:
    states = integrate.simulate(lambda t, x, u: MODEL.rates(x, u, theta), x0, controls, DT)
    return states, MODEL.outputs(states, controls, theta)


@pytest.mark.parametrize("flights", [1, 2, 5, 11])
def test_trajectories_are_those_of_the_reference(flights: int) -> None:
    x0, controls = starts(flights), sticks(flights, 120)
    got = dynamics().simulate(THETA, x0, controls, DT)
    for native, torch_result in zip(got, reference(x0, controls), strict=True):
        assert (native - torch_result).abs().max() < 1e-12 * torch_result.abs().max()


def test_one_sample_is_the_start() -> None:
    states, outputs = dynamics().simulate(THETA, starts(3), sticks(3, 1), DT)
    assert torch.equal(states[:, 0], starts(3))
    assert torch.allclose(outputs, MODEL.outputs(states, sticks(3, 1), THETA), rtol=1e-13)


def test_a_step_half_as_long_errs_by_a_sixteenth() -> None:
    """Controls stay off the corners of the table, where the order is less."""
    x0, ends, seconds = starts(1), torch.tensor([[0.3, -0.2], [0.8, 0.5]]).double(), 2.0

    def true_rates(t: Tensor, x: Tensor) -> Tensor:
        return MODEL.rates(x, ends[0] + (ends[1] - ends[0]) * (t / seconds), THETA)

    times = torch.tensor([0.0, seconds], dtype=torch.float64)
    exactly = {"step_t": times[1:]}  # a step ends there, for what lies within steps is interpolated to less
    exact = odeint(true_rates, x0, times, method="dopri8", rtol=1e-13, atol=1e-14, options=exactly)
    assert isinstance(exact, Tensor)
    errors = []
    for steps in (40, 80, 160):
        place = torch.linspace(0.0, 1.0, steps + 1, dtype=torch.float64)[:, None]
        states, _ = dynamics().simulate(THETA, x0, (ends[0] + (ends[1] - ends[0]) * place)[None], seconds / steps)
        errors.append(float((states[:, -1] - exact[-1]).norm()))
    for coarse, fine in itertools.pairwise(errors):
        assert coarse / fine == pytest.approx(16.0, rel=0.15)
    assert errors[-1] > 1e-12, "rounding would hide the order"


def test_what_diverges_is_held_at_the_limit() -> None:
    model = Dynamics.of(lambda x, u, th: (th * x * x, x), *(torch.ones(1).double(),) * 3)
    x0 = torch.tensor([[1.0], [-1.0]]).double()
    states, _ = model.simulate(torch.ones(1).double(), x0, torch.zeros(2, 200, 1).double(), 0.1, limit=1e3)
    assert states.isfinite().all()
    assert states[0, -1] >= 1e3
    assert -0.1 < states[1, -1] < 0.0
    free, _ = model.simulate(torch.ones(1).double(), x0, torch.zeros(2, 200, 1).double(), 0.1)
    assert not free[0].isfinite().all()
    assert torch.allclose(free[1], states[1], rtol=1e-13)


def linear_problem(samples: int = 40, patterns: bool = False) -> LinearProblem:
    """Four segments of unequal length, gaps in their residuals, controls that depend on the parameters PATH."""
    count = 4
    residual = draw(6, count, samples, NY)
    residual[draw(7, count, samples, NY) < -0.8] = torch.nan
    residual[1, 3] = torch.nan
    pattern = table = None
    if patterns:
        present = ~residual.isnan()
        kinds, pattern = present.reshape(-1, NY).unique(dim=0, return_inverse=True)
        pattern = pattern.reshape(count, samples).to(torch.int32).contiguous()
        table = draw(8, NY, NY).tril() * (kinds[:, :, None] & kinds[:, None, :])
        table = table.contiguous()
    return LinearProblem(
        dt=DT,
        length=torch.tensor([samples, 9, 1, samples - 1], dtype=torch.int32),
        controls=sticks(count, samples),
        path=draw(9, count, samples, NU, len(PATH)),
        residual=residual,
        x0=starts(count),
        theta=THETA,
        weight=torch.tensor([1.0, 2.0, 5.0, 0.3]).double(),
        pattern=pattern,
        table=table,
    )


def whitened(problem: LinearProblem, rows: Tensor, k: int) -> Tensor:
    """Rows [T, ny, n] of segment k as the whitening has them."""
    residual = problem.residual[k, : len(rows)]
    present = ~residual.isnan()
    if problem.pattern is None or problem.table is None:
        return rows * (problem.weight * present)[..., None]
    return problem.table[problem.pattern[k, : len(rows)].long()] @ torch.where(present[..., None], rows, 0.0)


def exact_rows(problem: LinearProblem, k: int, initial: bool, path: bool) -> tuple[Tensor, Tensor]:
    """Whitened rows of segment k by autograd through the reference [T ny, n], and the last state by the first."""
    n = int(problem.length[k])

    def run(x0: Tensor, theta: Tensor) -> tuple[Tensor, Tensor]:
        controls = problem.controls[k, :n]
        if path:
            controls = controls + problem.path[k, :n] @ (theta - THETA)[list(PATH)]
        states, y = reference(x0, controls, theta)
        return y, states[-1]

    jacobian, last = torch.func.jacrev(run, argnums=(0, 1))(problem.x0[k], THETA)
    columns = [*jacobian[0 if initial else 1 :], problem.residual[k, :n].nan_to_num().unsqueeze(-1)]
    rows = torch.cat(columns, dim=-1)
    return whitened(problem, rows, k).reshape(n * NY, -1), last[0]


def relative(got: Tensor, wanted: Tensor) -> float:
    """Column by column, of its largest entry."""
    size = wanted.abs().amax(dim=0, keepdim=True)
    return float(((got - wanted).abs() / torch.where(size > 0.0, size, 1.0)).max())


@pytest.mark.parametrize("initial", [True, False])
@pytest.mark.parametrize("path", [True, False])
@pytest.mark.parametrize("patterns", [True, False])
def test_sensitivities_are_those_of_autograd_through_the_reference(initial: bool, path: bool, patterns: bool) -> None:
    model, problem = (
        dynamics(path=PATH if path else (), initial=initial),
        linear_problem(patterns=patterns),
    )
    rows = model.whitened_rows(problem)
    H, passage = model.normal_equations(problem)
    assert rows.shape == (4, problem.samples * NY, (NX if initial else 0) + COUNT + 1)
    for k, length in enumerate(problem.length.tolist()):
        wanted, last = exact_rows(problem, k, initial, path)
        assert relative(rows[k, : length * NY], wanted) < 1e-9
        assert rows[k, length * NY :].abs().max() == 0.0 if length < problem.samples else True
        size = wanted.norm(dim=0)
        scale = torch.where(size > 0.0, size, 1.0)
        assert ((H[k] - (wanted.mT @ wanted).triu()) / (scale[:, None] * scale)).abs().max() < 1e-9
        if initial:
            assert (passage[k] - last).abs().max() < 1e-9 * last.abs().max()


@pytest.mark.parametrize("part", [40, 7])
def test_sensitivities_are_the_same_of_code_in_parts(part: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(emit, "PART", part)
    test_sensitivities_are_those_of_autograd_through_the_reference(initial=True, path=True, patterns=True)


def test_one_segment_alone() -> None:
    problem = linear_problem()
    one = replace(
        problem, **{name: getattr(problem, name)[:1] for name in ("length", "controls", "path", "residual", "x0")}
    )
    rows = dynamics().whitened_rows(one)
    wanted, _ = exact_rows(problem, 0, True, False)
    assert relative(rows[0], wanted) < 1e-9


def test_threads_and_company_do_not_change_a_bit() -> None:
    model, problem = dynamics(path=PATH), linear_problem()
    x0, controls = starts(19), sticks(19, 60)
    pairs = [
        (model.simulate(THETA, x0, controls, DT, threads=n) for n in (1, 2)),
        (model.normal_equations(problem, threads=n) for n in (1, 2)),
        ((model.whitened_rows(problem, threads=n),) for n in (1, 2)),
    ]
    for one, two in pairs:
        assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))
    alone, _ = model.simulate(THETA, x0[7:8], controls[7:8], DT)
    assert torch.equal(alone[0], model.simulate(THETA, x0, controls, DT)[0][7])


def test_models_that_differ_in_numbers_only_are_built_once() -> None:
    other = Model()
    for weight in other.network.parameters():
        weight.data = 1.7 * weight.data + 0.011
    ours = dynamics()
    theirs = Dynamics.of(other.motion, draw(1, NX), draw(2, NU), THETA)
    for a, b in ((ours.simulation, theirs.simulation), (ours.sensitivity, theirs.sensitivity)):
        assert a[0] == b[0]
        assert not torch.equal(a[1], b[1])


def test_triangles_have_the_same_product_and_leave_the_rest() -> None:
    n, first = 9, 4
    A = draw(20, 3, 30, n)
    A[1, :, 2] = 2.0 * A[1, :, 0]  # depends on the first column
    H = A.mT @ A
    top, rest = dynamics().triangles(H.triu(), first, 1e-3)
    for k in (0, 2):
        assert torch.allclose(top[k].mT @ top[k] + embedded(rest[k], first), H[k], rtol=1e-11, atol=1e-11)
    assert torch.equal(top[:, :, :first], top[:, :, :first].triu())
    assert top[1, 2, 2] == pytest.approx(1e-3 * (float(H[1, 2, 2]) ** 0.5 + 1e-3))
    assert top[1, 2, 3:].abs().max() == 0.0


def embedded(rest: Tensor, first: int) -> Tensor:
    whole = rest.triu() + rest.triu(1).mT
    return torch.nn.functional.pad(whole, (first, 0, first, 0))
