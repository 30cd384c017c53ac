"""The nominal model of a vehicle: which equations its data support, and the physics its declaration gives."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch

from rotorid_torch.core.names import FLAPPING, FORCES, MOMENTS, RATES, VELOCITIES
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.effects.base import Effect
from rotorid_torch.effects.reference import reference_of
from rotorid_torch.effects.registry import make
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.errors import InputError
from rotorid_torch.model.derivatives import LinearForces, TailInflow, Tailplane, TailRotor, ThrustTilt
from rotorid_torch.model.gusts import GUSTS, FedGusts
from rotorid_torch.model.inflow import CYCLIC, INDUCED, CyclicInflow, Inflow
from rotorid_torch.model.linear_equations import AlgebraicFlapping, Flapping, LinearBlock
from rotorid_torch.model.model import Body, Model
from rotorid_torch.model.rotors import Disturbance, Rotors, RotorSpeed, Surfaces, Telemetry, hover_input

PRIOR_SPAN = 5.0
"""A trim, or a derivative times its regressor's rms, may reach this many times its row's rms before the prior minds."""
TAIL_ARM, TAILPLANE_ARM = 1.2, 1.05
"""Distances of tail rotor and tailplane behind the centre of gravity, in rotor radii; usual, where none is declared."""
EVERYTHING = (-math.inf, math.inf)
FASTEST = 50.0
"""1/s: no body rate decays faster; a rate that follows its control at once ends here."""
DAMPING = (("L", "p"), ("M", "q"), ("N", "r"))
"""Rotors damp the body rates: without flapping to carry the damping, these derivatives are not positive."""
UNITS = {"X": "m/s2", "Y": "m/s2", "Z": "m/s2", "L": "rad/s2", "M": "rad/s2", "N": "rad/s2"}
SIGNAL_UNITS = dict.fromkeys((*VELOCITIES, INDUCED), "m/s") | dict.fromkeys(RATES, "rad/s")
SIGNAL_UNITS |= dict.fromkeys((*FLAPPING, *CYCLIC), "rad")


def rows(spec: ModelSpec) -> tuple[str, ...]:
    """Force and moment equations that the model has: X Y Z where forces show in the data, L M N always."""
    return tuple(r for r in (*FORCES, *MOMENTS) if r in spec.patterns)


def build(spec: ModelSpec, start: Mapping[str, float] = {}) -> Model:
    """The model of a spec, its parameters free or held and started as the spec says, or as `start` does by full name.

    A start moves theta, kept within its bounds; the parameter's declared value stays what its prior is about. It may
    know parameters that the model lacks.

    Raises InputError: an effect's id is unknown, or `free` or `values` name no parameter of the model.
    """
    body = Body(spec.states, (*spec.controls, *spec.inputs), spec.outputs, spec.gravity, spec.inertia, spec.imu)
    nominal = _multirotor(spec) if spec.motors else [*_rotor(spec), _forces(spec), *_physics(spec)]
    air = [FedGusts()] if set(GUSTS) <= set(spec.inputs) else []
    effects = [*nominal, *air, *(make(name, spec) for name in spec.effects)]
    for effect in effects:
        effect.declared = tuple(_as_specified(p, f"{effect.id}.{p.name}", spec) for p in effect.declared)
    model = Model(body, effects, spec.reference)
    for name in (*spec.free, *spec.values):
        if name not in model.parameter_set:
            listed = ", ".join(model.parameter_set.names)
            raise InputError("model", name, "there is no such parameter", f"one of {listed}")
    values = {**model.named_values, **spec.values, **start}
    model.put(model.parameter_set.clamp(model.theta.new_tensor([values[n] for n in model.parameter_set.names])))
    return model


def _as_specified(declared: Parameter, name: str, spec: ModelSpec) -> Parameter:
    """A parameter of an effect with what the spec says of it under its full name."""
    free, typical = spec.free.get(name, declared.free), spec.screening_sizes.get(name, declared.typical)
    changed = (free, typical) != (declared.free, declared.typical)
    return replace(declared, free=free, typical=typical) if changed else declared


def _multirotor(spec: ModelSpec) -> Sequence[Effect]:
    """Rotors at their places; where their speeds are measured, also what the commands make of these."""
    body: list[Effect]
    body, speeds = [Rotors(spec, PRIOR_SPAN), *_surfaces(spec), Disturbance(spec.sizes)], spec.driven
    if not speeds[0].startswith("omega"):
        return body
    at = sum(spec.reference[name] for name in spec.commands) / len(spec.commands)
    telemetry = Telemetry(spec.commands, speeds, hover_input(spec) / at)
    return [RotorSpeed(spec.commands, at), *body, telemetry]


def _surfaces(spec: ModelSpec) -> list[Effect]:
    """Free derivatives of every equation by the controls that are no motors."""
    if not spec.surfaces:
        return []
    declared = [p for row in rows(spec) for p in _row(spec, row, UNITS[row], spec.surfaces)[1:]]
    return [Surfaces(rows(spec), spec.surfaces, declared, spec.reference)]


def _rotor(spec: ModelSpec) -> list[Effect]:
    if spec.flapping == "none":
        return []
    lagged = spec.flapping == "first order"
    block = _block(spec, FLAPPING, "rad/s" if lagged else "rad")
    reference = reference_of(spec, block.columns)
    return [Flapping(block, reference) if lagged else AlgebraicFlapping(block, reference)]


def _forces(spec: ModelSpec) -> LinearForces:
    block = _block(spec, rows(spec), "")
    return LinearForces(block, reference_of(spec, block.columns))


def _block(spec: ModelSpec, names: Sequence[str], unit: str) -> LinearBlock:
    present = {c for r in names for c in spec.patterns[r]}
    columns = [c for c in (*VELOCITIES, *RATES, *FLAPPING, *spec.controls, INDUCED, *CYCLIC) if c in present]
    declared = [p for r in names for p in _row(spec, r, UNITS.get(r, unit), spec.patterns[r])]
    return LinearBlock(names, columns, spec.patterns, declared)


def _row(spec: ModelSpec, row: str, unit: str, columns: Sequence[str]) -> list[Parameter]:
    """Trim and derivatives of one equation, with priors scaled by the excursions of row and regressor."""
    size = spec.sizes.get(f"row.{row}", 1.0)
    trim = spec.reference.get(f"{row}.trim", 0.0)
    parameters = [Parameter(f"{row}.trim", trim, unit, prior_sd=PRIOR_SPAN * size, doc="value at the reference")]
    for column in columns:
        per = SIGNAL_UNITS.get(column) or spec.control_units.get(column, "1")
        sd = PRIOR_SPAN * size / max(spec.sizes.get(column, 1.0), 1e-12)
        bounds = (-FASTEST, 0.0) if (row, column) in DAMPING and FLAPPING[0] not in spec.patterns[row] else EVERYTHING
        parameters.append(Parameter(f"{row}.{column}", 0.0, per_unit(unit, per), bounds, sd, doc=f"d{row}/d{column}"))
    return parameters


def _physics(spec: ModelSpec) -> list[Effect]:
    """What the declared rotor and vehicle add beyond the tangent; nothing where they are not declared."""
    rotor, mass, inertia = spec.rotor, spec.mass, spec.inertia
    if rotor is None or mass is None or inertia is None or "Z" not in spec.patterns or "u" not in spec.states:
        return []
    tensor, lift = torch.tensor(inertia, dtype=torch.float64), spec.lift
    effects: list[Effect] = []
    if spec.flapping != "none" and spec.hub is not None:
        hub = torch.tensor(spec.hub, dtype=torch.float64)
        effects.append(ThrustTilt(hub, mass, tensor, rotor.spin, spec.reference, lift))
    if spec.inflow:
        effects.append(Inflow(rotor, spec.air_density, mass, tensor, spec.reference, lift))
    if spec.cyclic_inflow:
        effects.append(CyclicInflow(rotor, spec.reference))
    if "ped" in spec.controls:
        effects.append(TailRotor(TAIL_ARM * rotor.radius, spec.reference, spec.sizes))
        effects.append(TailInflow(spec.reference, spec.sizes, spec.control_units.get("ped", "rad")))
        effects.append(Tailplane(TAILPLANE_ARM * rotor.radius, spec.reference, spec.sizes))
    return effects


def derivative_unit(spec: ModelSpec, row: str, column: str) -> str:
    """Unit of the derivative of a force over mass, or a moment over inertia, by a signal."""
    return per_unit(UNITS[row], SIGNAL_UNITS.get(column) or spec.control_units.get(column, "1"))


def per_unit(above: str, below: str) -> str:
    """Unit of a quotient in the field's form: "1/s" for (rad/s2)/(rad/s), "m/(s2 rad)" for (m/s2)/rad, ..."""
    top, bottom = _powers(above), _powers(below)
    powers = {k: top.get(k, 0) - bottom.get(k, 0) for k in ("m", "rad", "kg", "s")}
    over = " ".join(_power(k, n) for k, n in powers.items() if n > 0) or "1"
    under = [_power(k, -n) for k, n in powers.items() if n < 0]
    if not under:
        return over
    return f"{over}/{under[0]}" if len(under) == 1 else f"{over}/({' '.join(under)})"


def _powers(unit: str) -> dict[str, int]:
    powers: dict[str, int] = {}
    for sign, part in zip((1, -1), unit.partition("/")[::2], strict=True):
        name = part.rstrip("0123456789")
        if name and name not in ("1", "norm"):
            powers[name] = sign * int(part[len(name) :] or 1)
    return powers


def _power(name: str, n: int) -> str:
    return name if n == 1 else f"{name}{n}"
