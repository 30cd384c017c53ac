"""Networks in effects: named, trained by every method, saved; what would not be trained is told."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from rotorid_torch.core.parameters import Parameter
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values
from rotorid_torch.effects.registry import EFFECTS, register
from rotorid_torch.errors import InputError
from rotorid_torch.identification.estimate.output_error import output_error
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.model.own_effects import extended, refuse_faulty
from rotorid_torch.model.save import load, save
from tests.known_models import DERIVATIVES, body_spec, flown, linear_vehicle, manoeuvres, points, with_values

DT = 0.02
NOISE = 0.01
ID = "my.network"


def network(seen: int = 2, hidden: int = 4) -> nn.Sequential:
    net = nn.Sequential(nn.Linear(seen, hidden), nn.Tanh(), nn.Linear(hidden, 1))
    for last in net[-1].parameters():
        nn.init.zeros_(last)
    return net


class Pitching(Effect):
    """A pitching moment that a network makes of the pitch rate and the longitudinal stick."""

    id, stage, role, weight_sd = ID, Stage.FORCES, Role.LEARNT, 2.0

    def __init__(self) -> None:
        super().__init__()
        self.net = network()

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        moment = self.net(4.0 * frame.stack(("q", "lon")))[..., 0]
        return frame.add(moment=torch.stack([0.0 * moment, moment, 0.0 * moment], dim=-1)), x


@pytest.fixture(autouse=True)
def _own() -> Iterator[None]:
    register(Pitching)
    yield
    EFFECTS.pop(ID, None)


def with_network() -> Model:
    return with_values(build(body_spec().with_effects(ID)), {f"forces.{k}": v for k, v in DERIVATIVES.items()})


def stirred(model: Model) -> Model:
    with torch.no_grad():
        model.theta.add_(0.1 * torch.randn(model.theta.shape, generator=torch.Generator().manual_seed(1)).double())
    return model


def test_weights_are_parameters_by_name_with_a_prior():
    model = with_network()
    mine = [p for p in model.parameter_set.parameters if p.name.startswith(ID)]
    assert len(mine) == 4 * 2 + 4 + 4 + 1
    assert [p.name for p in mine][6:9] == [f"{ID}.net.0.weight[3,0]", f"{ID}.net.0.weight[3,1]", f"{ID}.net.0.bias[0]"]
    assert mine[-1].name == f"{ID}.net.2.bias"
    assert {p.prior_sd for p in mine} == {2.0}
    assert with_network().named_values == model.named_values  # drawn alike


def test_the_network_computes_with_the_vector():
    """The model's numbers are those of the module with these weights, on one vector and on several."""
    model, net = stirred(with_network()), network().double()
    named = dict(model.named_parameters())
    net.load_state_dict({n: named[f"{ID}.net.{n}"].detach() for n, _ in net.named_parameters()})
    x, u = points(model, 5)
    theta = model.theta.detach()
    with torch.no_grad():
        still = theta.clone()
        still[-5:] = 0.0  # the last layer
        got = model.rates(theta, x, u) - model.rates(still, x, u)
        signals = torch.stack([x[:, model.body.states.index("q")], u[:, model.body.controls.index("lon")]], dim=-1)
        torch.testing.assert_close(got[:, model.body.states.index("q")], net(4.0 * signals)[:, 0])
        several = torch.stack([theta, still])[:, None]
        both = model.rates(several, x, u)
        paired = model.rates(several[:, 0], x[:2], u[:2])  # one point for each vector
    torch.testing.assert_close(both[0] - both[1], got)
    torch.testing.assert_close(paired, torch.stack([both[0, 0], both[1, 1]]))


def test_named_parameters_share_numbers_and_gradients():
    model = stirred(with_network())
    named = dict(model.named_parameters())
    assert named[f"{ID}.net.0.weight"].shape == (4, 2)
    assert named["forces.M.q"].shape == ()
    x0, u = points(model, 3)
    controls = u[:, None].expand(-1, 20, -1)

    def cost() -> Tensor:
        return model.trajectories(x0, controls, DT)[1].square().sum()

    (wanted,) = torch.autograd.grad(cost(), model.theta)
    model.zero_grad()
    cost().backward()
    cost().backward()  # two batches add up
    got = torch.cat([p.grad.reshape(-1) for _, p in model.named_parameters() if p.grad is not None])
    torch.testing.assert_close(got, 2.0 * wanted)
    named["forces.M.q"].grad = None  # as an optimiser of some lets go
    cost().backward()
    place = model.parameter_set.index("forces.M.q")
    torch.testing.assert_close(named["forces.M.q"].grad, wanted[place])
    before = model.theta.detach().clone()
    torch.optim.SGD([named["forces.M.q"]], lr=1e-3).step()
    assert (model.theta.detach() != before).nonzero().flatten().tolist() == [place]


def test_an_optimiser_keeps_its_parameters_where_the_model_moves():
    """To another type and back, as to a device: new storage, the same leaves, gradients and steps."""
    model = stirred(with_network())
    pitch = dict(model.named_parameters())["forces.M.q"]
    optimiser = torch.optim.SGD([pitch], lr=1e-3)
    model.float().double()
    x0, u = points(model, 3)
    model.trajectories(x0, u[:, None].expand(-1, 20, -1), DT)[1].square().sum().backward()
    before = model.theta.detach().clone()
    optimiser.step()
    place = model.parameter_set.index("forces.M.q")
    assert (model.theta.detach() != before).nonzero().flatten().tolist() == [place]
    assert dict(model.named_parameters())["forces.M.q"] is pitch


@pytest.mark.parametrize("move", [lambda model: model.to("cpu"), lambda model: model.float().double()])
def test_gradients_stay_where_the_model_moves(move: Callable[[Model], Model]):
    """As torch keeps them; what was let go of stays without, and steps and further gradients go on from there."""
    model = stirred(with_network())
    x0, u = points(model, 3)

    def back() -> None:
        model.trajectories(x0, u[:, None].expand(-1, 20, -1), DT)[1].square().sum().backward()

    named = dict(model.named_parameters())
    back()
    named["forces.M.w"].grad = None
    before = {n: p.grad.clone() for n, p in named.items() if p.grad is not None}
    move(model)
    after = {n: p.grad for n, p in model.named_parameters() if p.grad is not None}
    assert after.keys() == before.keys()
    for name, gradient in before.items():
        torch.testing.assert_close(after[name], gradient, rtol=1e-5, atol=1e-5)
    back()
    torch.testing.assert_close(named["forces.M.q"].grad, 2.0 * before["forces.M.q"], rtol=1e-4, atol=1e-5)


def hidden_moment() -> list[dict[str, Any]]:
    """Flights of a vehicle whose pitch damping stalls, beyond any derivative."""

    class Stall(Effect):
        id, stage, role = "hidden.stall", Stage.FORCES, Role.UNDECLARED

        def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
            moment = 1.5 * torch.tanh(6.0 * frame.signals["q"])
            return frame.add(moment=torch.stack([0.0 * moment, moment, 0.0 * moment], dim=-1)), x

    plain = linear_vehicle()
    truth = Model(plain.body, [*plain.chain, Stall()], plain.reference)
    truth.start_from(plain.named_values)
    data = flown(truth, manoeuvres(4.0, DT), DT)
    rows = []
    for name in ("f_lon", "f_col"):
        f = data.flights[name]
        states = f.stack(plain.body.states)
        outputs = f.stack(plain.body.outputs)
        rows.append({"time": f.time, "controls": f.stack(plain.body.controls), "outputs": outputs, "x0": states[0]})
    return rows


@pytest.mark.parametrize(("optimiser", "iterations", "times"), [("gauss-newton", 50, 1.1), ("lbfgs", 15, 4.0)])
def test_a_network_is_trained_like_any_parameter(optimiser: str, iterations: int, times: float):
    """It takes what no derivative can: down to the noise by Gauss-Newton, towards it by gradients alone."""
    model, flights = with_network(), hidden_moment()
    chance = torch.Generator().manual_seed(0)
    for flight in flights:
        flight["outputs"] += NOISE * torch.randn(flight["outputs"].shape, generator=chance, dtype=torch.float64)
    free = [n for n in model.parameter_set.names if n.startswith(ID)]
    q = model.body.outputs.index("q")
    how = {"segment_lengths": [2.0], "optimiser": optimiser, "max_iterations": iterations}
    found = output_error(model, flights, free, "fixed", NOISE**2 * torch.eye(11), **how)
    x0, controls = (torch.stack([f[k] for f in flights]) for k in ("x0", "controls"))
    before = torch.stack([f["outputs"] for f in flights]) - model.trajectories(x0, controls, DT)[1].detach()
    assert float(before[..., q].square().mean().sqrt()) > 10.0 * NOISE
    assert float(torch.cat([r[:, q] for r in found.residuals]).square().mean().sqrt()) < times * NOISE


def test_adam_trains_a_network_on_windows():
    model = with_network()
    flights = hidden_moment()
    x0 = torch.stack([f["x0"] for f in flights])
    controls, measured = (torch.stack([f[k] for f in flights]) for k in ("controls", "outputs"))
    adam = torch.optim.Adam([p for n, p in model.named_parameters() if n.startswith(ID)], lr=0.03)
    costs = []
    for _ in range(150):
        adam.zero_grad()
        _, outputs = model.trajectories(x0, controls, DT)
        costs.append((outputs - measured).square().mean())
        costs[-1].backward()
        adam.step()
    assert costs[-1] < 0.05 * costs[0]


def test_a_saved_network_is_read_back(tmp_path: Path):
    spec, model = body_spec().with_effects(ID), stirred(with_network())
    save(model, spec, tmp_path / "model.pt")
    assert load(tmp_path / "model.pt")[0].named_values == model.named_values


def an_effect(make: Callable[[Effect], None], forward: Any = None) -> type[Effect]:
    """An effect whose constructor does something to it."""

    def __init__(self: Effect) -> None:
        Effect.__init__(self)
        make(self)

    own = {} if forward is None else {"forward": forward}
    return type("Mine", (Pitching,), {"__init__": __init__, "id": ID, **own})


def frozen(effect: Any) -> None:
    effect.net = network()
    effect.net[0].requires_grad_(False)


def listed(effect: Any) -> None:
    effect.net, effect.nets = network(), [network()]


def unused(effect: Any) -> None:
    effect.net, effect.other = network(), nn.Linear(2, 2)


def lazy(effect: Any) -> None:
    effect.net = nn.LazyLinear(1)


SHARED = network()


def shared(effect: Any) -> None:
    effect.net = SHARED


def scripted(effect: Any) -> None:
    effect.net = torch.jit.script(network())


def normed(effect: Any) -> None:
    effect.net = nn.Sequential(nn.BatchNorm1d(2), network()).eval()


OUTSIDE = network().double()


def outside(effect: Any) -> None:
    effect.declared = (Parameter("k", 0.0, "1", (-1.0, 1.0)),)


def forward_outside(self: Effect, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
    moment = p["k"] * OUTSIDE(frame.stack(("q", "lon")))[..., 0]
    return frame.add(moment=torch.stack([moment, moment, moment], dim=-1)), x


@pytest.mark.parametrize(
    ("effect", "wrong"),
    [
        (an_effect(frozen), "net.0.weight: requires no gradient, so that it would not be trained"),
        (an_effect(listed), "nets: is a list of modules, whose weights would not be trained; expected nn.ModuleList"),
        (an_effect(unused), "other.weight: nothing depends on it, so that it would not be trained"),
        (an_effect(lazy), "net.weight: has no size yet"),
        (
            an_effect(shared),
            "net.0: is of another effect too, or of an earlier one of this class",
        ),
        (an_effect(scripted), "net: is a script, which keeps its weights; expected the module itself"),
        (
            an_effect(normed),
            "forward: holds a module for batches of one shape, as batch norm; expected modules",
        ),
        (
            an_effect(outside, forward_outside),
            "forward: computes with a tensor that requires gradients and is no parameter",
        ),
    ],
    ids=["frozen", "in a list", "unused", "lazy", "shared", "scripted", "normed", "outside"],
)
def test_what_would_not_be_trained_is_told_in_a_line(effect: type[Effect], wrong: str):
    EFFECTS.pop(ID)
    register(effect)
    with pytest.raises(InputError) as error:
        refuse_faulty([ID], body_spec())
    assert f"effect {ID}: {wrong}" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_sound_network_passes():
    refuse_faulty([ID], body_spec())


def test_priors_by_the_beginning_of_a_name():
    effect = Pitching()
    effect.weight_sd = {"net": 0.5, "net.2": 0.1}
    assert {p.name.rpartition(".")[0]: p.prior_sd for p in effect.declared} == {"net.0": 0.5, "net.2": 0.1}
    other = Pitching()
    other.weight_sd = {"encoder": 1.0}
    with pytest.raises(InputError, match=r"weight_sd: says nothing of net\.0\.weight; expected an entry 'net'"):
        _ = other.declared


def test_tied_weights_are_one():
    class Tied(Pitching):
        def __init__(self) -> None:
            Effect.__init__(self)
            self.net = nn.Sequential(nn.Linear(2, 2), nn.Tanh(), nn.Linear(2, 2), nn.Tanh(), nn.Linear(2, 1))
            self.net[2].weight = self.net[0].weight

    plain = linear_vehicle()
    model = Model(plain.body, [*plain.chain, Tied()], plain.reference)
    names = [n for n, _ in model.named_parameters() if n.startswith(ID)]
    assert [n.removeprefix(f"{ID}.net.") for n in names] == ["0.weight", "0.bias", "2.bias", "4.weight", "4.bias"]
    x, u = points(model, 2)
    assert model.rates(model.theta, x, u).isfinite().all()


def test_a_network_that_would_not_be_trained_is_refused_before_it_is_trained_in_torch():
    hidden = network()

    class Outside(Pitching):
        """A network that the effect does not hold."""

        id = "my.outside"

        def __init__(self) -> None:
            Effect.__init__(self, (Parameter("k", 0.0, "rad/s2", (-1.0, 1.0)),))

        def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
            moment = p["k"] * hidden(frame.stack(("q", "lon")))[..., 0]
            return frame.add(moment=torch.stack([0.0 * moment, moment, 0.0 * moment], dim=-1)), x

    register(Outside)
    model, spec = linear_vehicle(), body_spec()
    try:
        with pytest.raises(InputError, match=r"my\.outside"):
            extended(model, spec, ["my.outside"])
    finally:
        EFFECTS.pop("my.outside", None)
    with pytest.raises(InputError, match=r"did you mean 'my\.network'"):
        extended(model, spec, ["my.netwrok"])
    with pytest.raises(InputError, match="names in quotes"):
        extended(model, spec, [Pitching])  # pyright: ignore[reportArgumentType]
    more = extended(model, spec, [ID])
    assert {n: more.named_values[n] for n in model.named_values} == model.named_values
