"""Parameters of identifiable effects come back within three standard errors from flights simulated with them."""

from __future__ import annotations

import msgspec
import pytest
import torch

import rotorid_torch as rotorid
from rotorid_torch.core.integrate import simulate
from rotorid_torch.core.names import RATES, STICKS
from rotorid_torch.effects.examples import HELICOPTER, MULTIROTOR
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from tests.known_models import DERIVATIVES, manoeuvres, with_values

DT = 0.02
STEERED = ("forces.L.p", "forces.M.q", "forces.Z.w", "rotors.power.L", "rotors.power.N", "rotors.thrust.c2")
"""Derivatives, control powers and thrust that are free beside the effect."""
RIGID = msgspec.structs.replace(
    HELICOPTER,
    flapping="none",
    hub=None,
    outputs=HELICOPTER.outputs[:-3],
    patterns={
        row: tuple(n for n in columns if n not in ("a0", "a1", "b1")) for row, columns in HELICOPTER.patterns.items()
    },
)
FLAPPING = {
    "rotor.a0.a0": -20.0, "rotor.a0.col": 10.0, "rotor.a1.a1": -8.0, "rotor.b1.b1": -8.0, "rotor.a1.lon": -8.0,
    "rotor.b1.lat": 8.0, "rotor.a1.q": -1.0, "rotor.b1.p": -1.0, "rotor.a1.b1": -3.0, "rotor.b1.a1": 3.0,
    "forces.X.a1": -9.8, "forces.Y.b1": 9.8, "forces.L.b1": 25.0, "forces.M.a1": 4.0,
}  # fmt: skip
QUAD = msgspec.structs.replace(
    MULTIROTOR, inputs=(), states=RATES, outputs=(*RATES, "az"), patterns=dict.fromkeys(("Z", "L", "M", "N"), ())
)
"""Rates and thrust of a quadrotor: no attitude that it could tip over."""

CASES: dict[str, tuple[ModelSpec, dict[str, float]]] = {
    "control.delay": (RIGID, {}),
    "control.lag": (RIGID, {}),
    "control.rate_limit": (RIGID, {}),
    "control.backlash": (RIGID, {}),
    "forces.quadratic_damping": (RIGID, {}),
    "mass.slung_load": (RIGID, {}),
    "rotor.speed": (RIGID, {}),
    "rotor.stall": (RIGID, {"limit": 0.075}),
    "rotor.inflow": (HELICOPTER, {}),
    "rotor.flap_second_order": (HELICOPTER, {"share": 0.8}),
    "rotor.lead_lag": (HELICOPTER, {}),
    "rotor.wake_distortion": (HELICOPTER, {}),
    "propulsion.motor_lag": (QUAD, {}),
    "propulsion.rotor_inertia": (QUAD, {}),
}
ENDED = 1e-3
"""Share of a size by which a fit may end beside it, whatever its standard error: fits end where costs hardly fall."""
QUICK = ("control.delay", "forces.quadratic_damping")


def vehicle(effect: str) -> tuple[Model, dict[str, float]]:
    """A damped vehicle with the effect at typical size, and those sizes."""
    spec, changes = CASES[effect]
    model = build(msgspec.structs.replace(spec, effects=(effect,)))
    known = {f"forces.{n}": v for n, v in DERIVATIVES.items()}
    if spec is not RIGID:
        known = known | FLAPPING if spec is HELICOPTER else {}
    sizes = {
        p.name: changes.get(p.name.removeprefix(f"{effect}."), p.typical)
        for p in model.parameter_set.parameters
        if p.name.startswith(f"{effect}.") and p.free
    }
    return with_values(model, known | sizes), sizes


def flights(model: Model, noise: float = 0.01) -> list[dict[str, torch.Tensor]]:
    """Four flights from the reference, with noise of this share of each output's size."""
    at = lambda names: torch.tensor([model.reference.get(n, 0.0) for n in names], dtype=torch.float64)  # noqa: E731
    generator = torch.Generator().manual_seed(3)
    size = 0.05 if model.body.controls == STICKS else 0.005
    made = []
    for moves in manoeuvres(8.0, DT, model.body.controls, size).values():
        u = at(model.body.controls) + torch.tensor(moves)
        with torch.no_grad():
            tape = model.tape(u, DT)
            x = simulate(model, at(model.layout.names), tape, DT)
            y = model.output(x, tape)
        assert bool(y.isfinite().all())
        shake = torch.randn(y.shape, generator=generator, dtype=torch.float64) * noise * y.std(0).clamp(min=1e-4)
        made.append({"time": DT * torch.arange(len(u)), "controls": u, "outputs": y + shake, "x0": x[0]})
    return made


@pytest.mark.parametrize("effect", [pytest.param(e, marks=[] if e in QUICK else [pytest.mark.slow]) for e in CASES])
def test_parameters_come_back_within_three_standard_errors(effect: str):
    model, sizes = vehicle(effect)
    data = flights(model)
    steered = [n for n in STEERED if n in model.parameter_set]
    start = {n: 0.7 * v for n, v in sizes.items()} | {
        n: 0.9 * float(model.theta.detach()[model.parameter_set.index(n)]) for n in steered
    }
    low, high = model.parameter_set.lower, model.parameter_set.upper
    for n, v in start.items():
        i = model.parameter_set.index(n)
        start[n] = min(max(v, float(low[i])), float(high[i]))
    found = rotorid.output_error(with_values(model, start), data, free=[*sizes, *steered], x0="fixed")
    for p in found.parameters:
        if p.name in sizes:
            assert p.status == "free", p
            assert 0.0 < p.se < 0.5 * abs(sizes[p.name]) + 1e-3, p
            assert abs(p.value - sizes[p.name]) < max(3.0 * p.se, ENDED * abs(sizes[p.name])), (p, sizes[p.name])
