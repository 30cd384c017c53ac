"""Torch functions as scalar expressions: the same values and derivatives, or a refusal that says what and where."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from rotorid_torch.core.native.graph.symbols import Graph
from rotorid_torch.core.native.graph.tracing import Unsupported, scalarise
from tests.core.native.graph.evaluation import traced_jacobian, traced_value


def draw(seed: int, *shape: int) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


X, Y = draw(1, 6), draw(2, 6)
M, PICK, EYE = draw(3, 6, 6), torch.tensor([0, 2, 4]), torch.eye(3, dtype=torch.float64)
ODD = torch.tensor([True, False] * 3)
NETWORK = (
    torch.nn.Sequential(torch.nn.Linear(6, 4), torch.nn.Tanh(), torch.nn.Linear(4, 2)).double().requires_grad_(False)
)
F = torch.nn.functional


def whole(x: Tensor) -> Tensor:
    """Symmetric positive definite, of order len(x)."""
    return x[..., :, None] * x[..., None, :] + torch.eye(x.shape[-1], dtype=torch.float64)


def writes_one_entry(x: Tensor, y: Tensor) -> Tensor:
    out = torch.zeros_like(x)
    out[..., 0] = y[1]
    out[..., 1:3] = 2.0 * x[:2]
    out[3] += x[0] * y[0]
    return out


def writes_by_index(x: Tensor, y: Tensor) -> Tensor:
    out = x.clone()
    out[PICK] = y[PICK]
    out[..., torch.tensor([1, 0])] = x[:2]
    out[ODD] *= 3.0
    return out.add_(1.0)


def writes_into_views(x: Tensor, y: Tensor) -> Tensor:
    out = torch.zeros(2, 3, dtype=torch.float64)
    out[:, 1] = x[:2]
    out.view(-1)[3:].copy_(y[3:])
    out.masked_fill_(ODD.view(2, 3), 7.0)
    return out


KNOWN: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    # entries moved about
    "cat": lambda x, y: torch.cat([x[2:], y[:1], torch.ones(1).double()]),
    "stack": lambda x, y: torch.stack([x[..., 0], y[..., -1] * 2.0, torch.tensor(3.0).double()], dim=-1),
    "slices": lambda x, y: x[1:5:2] + y[..., None][:2, 0],
    "index": lambda x, y: x[PICK] * y[ODD],
    "gather": lambda x, y: x.gather(0, PICK) + y.take(PICK).detach() * 0.0 + x.index_select(0, PICK),
    "one entry": writes_one_entry,
    "index_put": writes_by_index,
    "views": writes_into_views,
    "scatter": lambda x, y: x.scatter(0, PICK, y[:3]),
    "broadcast": lambda x, y: x[:, None] * y[None, :] + torch.arange(6).double(),
    "expand": lambda x, y: x.expand(2, 6) + y.repeat(2, 1) + x.repeat_interleave(2).view(2, 6),
    "permute": lambda x, y: x.view(1, 2, 3).permute(2, 0, 1) * y.view(3, 1, 2).mT.mT,
    "roll": lambda x, y: x.roll(1, -1) + y.flip(0),
    "unbind": lambda x, y: torch.stack(x.unbind()[::-1]) + torch.cat(y.split([2, 4])[::-1]) + torch.cat(x.chunk(2)),
    "pad": lambda x, y: F.pad(x, (1, 2)) + F.pad(y, (2, 1), value=2.5),
    "diag": lambda x, y: torch.diag(x) + torch.diag_embed(y) + torch.triu(x[:, None] * y),
    "diagonal": lambda x, y: (x[:, None] * y).diagonal() + (x[:, None] * y).trace(),
    "block_diag": lambda x, y: torch.block_diag(x.view(2, 3), y.view(2, 3)),
    "new": lambda x, y: torch.cat([x.new_zeros(1), x.new_full((1,), 2.0), torch.full_like(y, 3.0) * x]),
    "constant": lambda x, y: torch.ones(3).double(),
    "detach": lambda x, y: y.contiguous().clone() + x.detach() * 0.0,
    # entry by entry
    "arithmetic": lambda x, y: -x / y + 2.0 / x - (3.0 - y) * x + x.reciprocal() + x.square() * y.abs().rsqrt(),
    "alpha": lambda x, y: torch.add(x, y, alpha=0.5) + torch.sub(x, y, alpha=2.5) + torch.rsub(x, y, alpha=3.0),
    "fused": lambda x, y: torch.addcmul(x, x, y, value=2.0) + torch.addcdiv(x, x, y) + torch.lerp(x, y, 0.3),
    "where": lambda x, y: torch.where(x > y, x, 2.0 * y) + torch.where(x >= 0.0, torch.sqrt(x.abs()), -1.0),
    "conditions": lambda x, y: torch.where(((x > 0) & (y > 0)) | ~(x < y), x, y) + torch.where(x == x.relu(), y, 0.0),
    "conditions as numbers": lambda x, y: (x > 0) * y + (x < y).double() + (x != y).to(x) * 2.0,
    "clamp": lambda x, y: x.clamp(-0.5, 0.5) + x.clamp(min=0.1) + y.clamp(max=0.2) + torch.clamp(x, y - 1.0, y + 1.0),
    "extremes": lambda x, y: torch.maximum(x, y) + torch.minimum(x, 0.5 * y),
    "pow": lambda x, y: x**2 + y**-3 + x**5 + y**1 + x**0 + x.abs() ** 1.5 + y.abs() ** 0.5 + 2.0**x,
    "power of variables": lambda x, y: x.abs() ** y + torch.pow(x, torch.arange(6.0).double()),
    "functions": lambda x, y: (0.2 * x).asin() + (0.2 * y).acos() * x.atan() + y.abs().log1p() * x.tan(),
    "trigonometry": lambda x, y: x.sin() * y.cos() + torch.atan2(x, y) + torch.deg2rad(x) + torch.hypot(x, y),
    "softplus": lambda x, y: F.softplus(x) + F.softplus(y, beta=5.0) + F.softplus(30.0 * x) + torch.sigmoid(y),
    "activations": lambda x, y: x.relu() + x.tanh() * F.silu(y) + F.leaky_relu(x) + F.hardtanh(y) + x.sign() * y,
    # sums and products
    "mean": lambda x, y: x.mean() + y.view(2, 3).mean(-1, keepdim=True) + x.view(2, 3).sum(0) + y.cumsum(0)[-1],
    "norm": lambda x, y: x.norm() * torch.linalg.norm(y.view(2, 3), dim=-1, keepdim=True) * F.normalize(x, dim=0),
    "cross": lambda x, y: torch.linalg.cross(x.view(2, 3), y.view(2, 3)) + torch.cross(y[:3], x[3:], dim=-1),
    "outer": lambda x, y: torch.outer(x, y) + torch.kron(x[:2], y[:3]).view(6, 1),
    "einsum": lambda x, y: torch.einsum("i,ij,j->", x, M, y) + torch.einsum("...i,ji->...j", x, M),
    "matmul": lambda x, y: M @ x + y @ M + (x.view(2, 3) @ y.view(2, 3).mT).sum() + x @ y,
    "batched products": lambda x, y: x.view(2, 1, 3) @ y.view(2, 3, 1) + (x.view(2, 3, 1) @ y.view(2, 1, 3)),
    "linear": lambda x, y: F.linear(x, M, y) + torch.addmv(x, M, y) + torch.mv(M, x),
    "network": lambda x, y: NETWORK(x) * NETWORK(y.view(1, 6)).squeeze(0) + NETWORK(torch.stack([x, y])).sum(0),
    "vmap": lambda x, y: torch.func.vmap(lambda a, b: a * b)(x, y),
    # small linear systems
    "solve": lambda x, y: torch.linalg.solve(whole(x[:3]), y[:3]) + torch.linalg.solve(whole(y[:2]), x[:2]).sum(),
    "solve matrices": lambda x, y: torch.linalg.solve(whole(x[:3]), y.view(3, 2)),
    "solve batches": lambda x, y: torch.linalg.solve(whole(x.view(2, 3)), y.view(2, 3)),
    "inv": lambda x, y: torch.linalg.inv(whole(x[:3])) @ torch.linalg.inv(2.0 * EYE + whole(y[3:])),
    "det": lambda x, y: torch.linalg.det(whole(x.view(2, 3))) + torch.linalg.inv(y[:1, None]).sum(),
}  # fmt: skip


@pytest.mark.parametrize("name", KNOWN)
def test_values_at_another_point_and_derivatives(name: str) -> None:
    function, at = KNOWN[name], {"x": X + 0.1 * Y, "y": 1.2 * Y - 0.1 * X}
    wanted = function(*(value.clone() for value in at.values())).reshape(-1)
    got = traced_value(function, {"x": X, "y": Y}, at)
    assert torch.allclose(got, wanted, rtol=1e-13, atol=1e-13)
    if name == "detach":
        return
    slopes = torch.func.jacrev(lambda x, y: function(x.clone(), y.clone()).reshape(-1), argnums=(0, 1))(*at.values())
    for found, exact in zip(traced_jacobian(function, at).values(), slopes, strict=True):
        assert torch.allclose(found, exact, rtol=1e-11, atol=1e-12)


def test_small_whole_powers_are_products() -> None:
    graph = Graph()
    scalarise(graph, lambda x: x.square() + x**3 + x**-2.0 + x.abs() ** 0.5, {"x": X})
    assert not any(node[0] == "pow" for node in graph.nodes)


def test_a_norm_has_a_derivative_where_all_is_zero() -> None:
    found = traced_jacobian(lambda x: x.norm() * x, {"x": torch.zeros(3).double()})
    assert torch.equal(found["x"], torch.zeros(3, 3).double())


def test_what_does_not_depend_on_an_input_costs_nothing() -> None:
    graph = Graph()
    nodes = scalarise(graph, lambda x: (M @ M).sort().values.sum() * x, {"x": X})
    kinds = [graph.operation(n) for n in graph.needed(nodes)]
    assert kinds.count("constant") == 1
    assert kinds.count("mul") == 6
    assert len(kinds) == 13


def test_a_model_with_batch_dimensions_may_be_traced_with_them() -> None:
    def function(x: Tensor, y: Tensor) -> Tensor:
        return torch.stack([x[..., 0] * y[..., 1], torch.linalg.solve(whole(x[..., :3]), y[..., :3])[..., 0]], dim=-1)

    flat = traced_value(function, {"x": X, "y": Y}, {"x": X, "y": Y})
    batched = traced_value(function, {"x": X[None], "y": Y[None]}, {"x": X, "y": Y})
    assert torch.equal(flat, batched)


class Strange(torch.nn.Module):
    """An effect whose forward does what native code cannot."""

    id = "forces.strange"

    def __init__(self, rule: Callable[[Tensor, Tensor], Tensor]) -> None:
        super().__init__()
        self.rule = rule

    def forward(self, x: Tensor, y: Tensor) -> Tensor:
        return self.rule(x, y)


REFUSED: dict[str, tuple[Callable[[Tensor, Tensor], Tensor], str]] = {
    "searchsorted": (lambda x, y: y[torch.searchsorted(torch.arange(5).double(), x)], "searchsorted is not known"),
    "index by data": (lambda x, y: y[x > 0.0], "index that depends on the inputs"),
    "nonzero": (lambda x, y: y[(x > 0.0).nonzero()[:, 0]], "nonzero is not known"),
    "branch": (lambda x, y: x if x[0] > 0.0 else y, "a branch or a number that depends"),
    "item": (lambda x, y: x[0].item() * y, "a branch or a number that depends"),
    "float": (lambda x, y: float(x[0]) * y, "a branch or a number that depends"),
    "sort": (lambda x, y: x.sort().values, "sort is not known"),
    "solve of order 4": (lambda x, y: torch.linalg.solve(whole(x[:4]), y[:4]), "order above 3"),
    "inverse of order 4": (lambda x, y: torch.linalg.inv(whole(x[:4])), "order above 3"),
    "norm of order 1": (lambda x, y: x.norm(p=1), "other than the Euclidean"),
    "float32": (lambda x, y: x.float().double(), "conversion to float32"),
    "integers": (lambda x, y: x.long() * y, "conversion to int64"),
    "rounded division": (lambda x, y: torch.div(x, y, rounding_mode="floor"), "div with rounding_mode"),
    "scaled product": (lambda x, y: torch.addmm(EYE, x[:3, None], y[None, :3], beta=2.0), "addmm with beta"),
    "sum into places": (lambda x, y: x.index_add(0, PICK, y[:3]), "adds to what is there"),
    "numbers taken for conditions": (lambda x, y: torch.logical_and(x, y) * x, "taken for a condition"),
    "tolist": (lambda x, y: torch.tensor(x.tolist()) * y, "tolist"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_known_is_refused_with_effect_file_and_line(name: str) -> None:
    rule, reason = REFUSED[name]
    with pytest.raises(Unsupported, match=reason) as told:
        scalarise(Graph(), Strange(rule), {"x": X, "y": Y})
    line = rule.__code__.co_firstlineno
    assert f"(effect 'forces.strange', {__file__}, line {line})" in str(told.value)


def test_what_is_handed_in_must_not_be_overwritten() -> None:
    with pytest.raises(Unsupported, match="overwritten"):
        scalarise(Graph(), lambda x: x.mul_(2.0), {"x": X})


@pytest.mark.parametrize(
    "function",
    [lambda x: x + torch.rand(6).double(), lambda x: torch.as_tensor(x.numpy() * 2.0)],
    ids=["random", "numpy"],
)
def test_what_was_not_followed_is_found_at_another_point(function: Callable[[Tensor], Tensor]) -> None:
    with pytest.raises(Unsupported, match=r"tried at another, result \d is \S+ where torch says"):
        scalarise(Graph(), function, {"x": X})
