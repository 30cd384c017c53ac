"""Models and vehicles with known numbers: a declared helicopter with every stage, and a linear one to identify."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from rotorid_torch.core.integrate import simulate
from rotorid_torch.core.names import FLAPPING, FORCES, MOMENTS, RATES, STICKS, VELOCITIES
from rotorid_torch.data import Dataset
from rotorid_torch.data.write import write_dataset
from rotorid_torch.effects.spec import FlappingKind, ModelSpec, RotorSpec
from rotorid_torch.model.inflow import INDUCED, trim_velocity
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build

BODY = (*VELOCITIES, *RATES, "phi", "theta")
INERTIA = ((7600.0, 0.0, -2260.0), (0.0, 52000.0, 0.0), (-2260.0, 0.0, 49900.0))
ROTOR = RotorSpec(blades=4, radius=8.18, chord=0.53, speed=27.0, hinge_offset=0.381, lock_number=8.2)
IMU = (0.8, -0.3, 0.5)

DERIVATIVES = {
    "X.u": -0.05, "X.q": 0.4, "X.lon": -6.0, "Y.v": -0.1, "Y.p": -0.4, "Y.lat": 6.0, "Z.w": -0.5, "Z.col": -90.0,
    "L.v": -0.03, "L.p": -3.0, "L.q": -0.6, "L.lat": 30.0, "M.u": 0.01, "M.p": 0.2, "M.q": -2.0, "M.lon": 15.0,
    "N.v": 0.02, "N.r": -0.8, "N.col": 4.0, "N.ped": 12.0,
}  # fmt: skip
"""Hover derivatives of a damped helicopter without flapping, SI."""


def body_spec(**changes: Any) -> ModelSpec:
    """A rigid helicopter in hover, forces and moments linear in velocities, rates and controls; nothing declared."""
    columns = (*VELOCITIES, *RATES, *STICKS)
    reference = dict.fromkeys((*BODY, *STICKS), 0.0) | {"X.trim": 0.0, "Y.trim": 0.0, "Z.trim": -9.80665}
    spec = ModelSpec(
        states=BODY,
        controls=STICKS,
        outputs=(*BODY, "ax", "ay", "az"),
        reference=reference,
        sizes={},
        ranges={n: (-10.0, 10.0) for n in (*BODY, *STICKS)},
        patterns=dict.fromkeys((*FORCES, *MOMENTS), columns),
        control_units=dict.fromkeys(STICKS, "rad"),
        imu=IMU,
    )
    return msgspec.structs.replace(spec, **changes)


def helicopter_spec(flapping: FlappingKind = "first order", **changes: Any) -> ModelSpec:
    """A declared helicopter about an uneven reference: every stage of the nominal model is there."""
    reference: dict[str, float] = {
        "u": 4.0, "v": -1.0, "w": 0.6, "p": 0.0, "q": 0.0, "r": 0.0, "phi": -0.04, "theta": 0.07,
        "lon": 0.02, "lat": -0.03, "col": 0.25, "ped": 0.2, "a0": 0.06, "a1": 0.03, "b1": -0.02,
    }  # fmt: skip
    lagged = flapping == "first order"
    columns = (*VELOCITIES, *RATES, *STICKS, *(FLAPPING if lagged else ()), INDUCED)
    spec = body_spec(
        reference=reference,
        outputs=(*BODY, "ax", "ay", "az", "pdot", *(FLAPPING if flapping != "none" else ())),
        patterns=dict.fromkeys((*FORCES, *MOMENTS, *(FLAPPING if flapping != "none" else ())), columns),
        flapping=flapping,
        inflow=True,
        mass=7257.0,
        inertia=INERTIA,
        hub=(0.1, 0.05, -2.1),
        rotor=ROTOR,
    )
    phi, theta = reference["phi"], reference["theta"]
    weight = -9.80665 * np.array([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])
    reference |= {INDUCED: trim_velocity(ROTOR, 1.225, 7257.0, reference, spec.lift)}
    reference |= {f"{row}.trim": float(value) for row, value in zip(FORCES, weight, strict=True)}
    if flapping == "algebraic":
        reference |= {f"{row}.trim": reference[row] for row in FLAPPING}
    return msgspec.structs.replace(spec, **{"reference": reference, **changes})


def with_values(model: Model, values: dict[str, float]) -> Model:
    """The model with these parameters set, in place."""
    with torch.no_grad():
        for name, value in values.items():
            model.theta[model.parameter_set.index(name)] = value
    return model


def scattered(model: Model, seed: int = 0) -> Model:
    """The model with every derivative random, trims, time constants and shares as declared; rotor and rates damped."""
    generator = torch.Generator().manual_seed(seed)
    noise = 0.1 * torch.randn(len(model.theta), generator=generator, dtype=torch.float64)
    for i, name in enumerate(model.parameter_set.names):
        if name.endswith((".trim", ".tau")) or name.startswith("rotor.tilt"):
            noise[i] = 0.0
    damped = {f"rotor.{n}.{n}": -8.0 for n in FLAPPING} | {"forces.L.p": -2.0, "forces.M.q": -1.0, "forces.N.r": -0.5}
    with torch.no_grad():
        model.theta.copy_(model.parameter_set.clamp(model.theta + noise))
    return with_values(model, {n: v for n, v in damped.items() if n in model.parameter_set})


def helicopter(flapping: FlappingKind = "first order", seed: int = 0, **changes: Any) -> Model:
    """`helicopter_spec` with scattered derivatives."""
    return scattered(build(helicopter_spec(flapping, **changes)), seed)


def linear_vehicle(**changes: Any) -> Model:
    """`body_spec` with `DERIVATIVES`."""
    return with_values(build(body_spec(**changes)), {f"forces.{n}": v for n, v in DERIVATIVES.items()})


def points(model: Model, count: int, seed: int = 0, spread: float = 0.1) -> tuple[Tensor, Tensor]:
    """States [count, nx] and controls [count, nu] about the model's reference."""
    generator = torch.Generator().manual_seed(seed)
    at = lambda names: torch.tensor([model.reference.get(n, 0.0) for n in names], dtype=torch.float64)  # noqa: E731
    noise = lambda n: spread * torch.randn(count, n, generator=generator, dtype=torch.float64)  # noqa: E731
    return at(model.layout.names) + noise(len(model.layout)), at(model.body.controls) + noise(len(model.body.controls))


def doublet(time: np.ndarray, start: float, width: float, size: float) -> np.ndarray:
    """Plus for `width` s from `start`, minus for as long."""
    return size * (
        ((time > start) & (time <= start + width)) * 1.0 - ((time > start + width) & (time <= start + 2 * width))
    )


def manoeuvres(seconds: float, dt: float, names: tuple[str, ...] = STICKS, size: float = 0.04) -> dict[str, np.ndarray]:
    """One flight per control [T, nu]: a 3-2-1-1 in it from 1 s on, small doublets in the others later."""
    time = dt * np.arange(round(seconds / dt) + 1)
    flights = {}
    for k, name in enumerate(names):
        controls = np.zeros((len(time), len(names)))
        edges, at = (0.9, 0.6, 0.3, 0.3), 1.0
        for i, width in enumerate(edges):
            controls[:, k] += size * (-1) ** i * ((time > at) & (time <= at + width))
            at += width
        for j in range(1, len(names)):
            controls[:, (k + j) % len(names)] += doublet(time, 3.0 + 0.9 * j, 0.4, 0.5 * size * (-1) ** k)
        flights[f"f_{name}"] = controls
    return flights


def flown(
    model: Model,
    controls: dict[str, np.ndarray],
    /,
    dt: float = 0.02,
    noise: float = 0.0,
    seed: int = 0,
    lists: dict[str, list[str]] | None = None,
    **declared: Any,
) -> Dataset:
    """Data set of the model's own flights from its reference; `noise` times each channel's rms is added to it."""
    rng = np.random.default_rng(seed)
    x0 = torch.tensor([model.reference.get(n, 0.0) for n in model.layout.names], dtype=torch.float64)
    start = torch.tensor([model.reference.get(n, 0.0) for n in model.body.controls], dtype=torch.float64)
    u = start + pad_sequence([torch.tensor(moves) for moves in controls.values()], batch_first=True)
    with torch.no_grad():
        tape = model.tape(u, dt)
        y = model.output(simulate(lambda t, x, u: model.rates(model.theta, x, u), x0, tape, dt), tape)
    outputs, record = model.body.outputs, torch.cat([u, y], dim=-1)
    clean = {
        name: dict(zip((*model.body.controls, *outputs), rows[: len(controls[name])].numpy().T, strict=True))
        for name, rows in zip(controls, record, strict=True)
    }
    size = {c: float(np.sqrt(np.mean([np.var(f[c]) for f in clean.values()]))) for c in outputs}
    sd = {c: max(noise * size[c], 1e-7) for c in outputs}
    flights = {
        name: {"time": dt * np.arange(len(next(iter(f.values()))))}
        | {c: f[c] for c in model.body.controls}
        | {c: f[c] + (sd[c] if noise else 0.0) * rng.standard_normal(len(f[c])) for c in outputs}
        for name, f in clean.items()
    }
    lists = lists or {"identify": list(flights)}
    declared.setdefault("controls", {c: {"unit": "rad", "noise": 1e-7} for c in model.body.controls})
    declared.setdefault("channels", {c: {"noise": sd[c], "bias": "none"} for c in outputs})
    declared.setdefault("vehicle", {"imu": list(model.body.imu)})
    return Dataset.from_arrays(flights, **lists, **declared)


def written(dataset: Dataset, place: Path) -> Path:
    """A flown data set as a folder."""
    return write_dataset(
        place,
        {name: {c: v.numpy() for c, v in flight.channels.items()} for name, flight in dataset.flights.items()},
        identify=dataset.identify,
        validate=dataset.validate,
        acid=dataset.acid,
        controls=dict(dataset.control_specs),
        channels=dict(dataset.channel_specs),
    )


def rate_vehicle(**changes: Any) -> Model:
    """The rates of `linear_vehicle` alone: three states, nothing else measured."""
    spec = body_spec(
        states=RATES, outputs=RATES, patterns=dict.fromkeys(MOMENTS, (*RATES, *STICKS)), imu=(0.0, 0.0, 0.0), **changes
    )
    model = build(spec)
    return with_values(model, {n: DERIVATIVES.get(n[7:], 0.0) for n in model.parameter_set.names if n[:7] == "forces."})
