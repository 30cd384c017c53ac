"""Which model the data support: states, equations, regressors, lag of the flapping; before anything is fitted."""

import math
from collections.abc import Sequence
from typing import Any

import msgspec
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from rotorid_torch.core.least_squares import least_squares
from rotorid_torch.core.names import ATTITUDES, FLAPPING, FORCES, MOMENTS, RATES, SPECIFIC_FORCES, VELOCITIES, is_motor
from rotorid_torch.core.recursion import followed, linear
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.schema import Vehicle
from rotorid_torch.effects.registry import obstacle, predicted_by
from rotorid_torch.effects.spec import FlappingKind, ModelSpec, MotorSpec, RotorSpec, usual_arm
from rotorid_torch.identification.mixer import Mixer, find_mixer
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction
from rotorid_torch.model.inflow import CYCLIC, INDUCED, trim_velocity

ATTITUDE = ATTITUDES[:2]
OUTPUTS = (*VELOCITIES, *RATES, *ATTITUDE, *SPECIFIC_FORCES, *FLAPPING)
LAGGED = 40
"""Identify flights that tell the lag, at most."""
LAGS = (0, 1, 2, 3, 4, 6, 8, 11, 16, 24, 32)
"""Samples of first-order lag that are tried between flapping and what drives it."""
DOUBTFUL = 2
"""Samples: flapping that lags its drivers by no more than this may as well be algebraic; none at all: it is."""
FLAP_TIME = 0.1
"""s: usual time in which flapping follows; scales the prior of the flapping rates only."""


def have(dataset: Dataset, names: Sequence[str]) -> bool:
    """Whether all identify flights have all these channels."""
    return all(dataset.facts[f].has(*names) for f in dataset.identify)


def propose(dataset: Dataset, reconstruction: Reconstruction | None, effects: Sequence[str] = ()) -> ModelSpec:
    """The nominal structure for a data set: what is measured and declared decides, nothing is tuned.

    Velocities are states where they and the attitude are measured; forces have equations where velocities or all
    specific forces are; flapping is first order, or algebraic where it follows its drivers without lag; the induced
    velocity is a state where the rotor is declared.

    reconstruction : None before step 1; the sizes of forces and moments are one then.
    """
    moving = have(dataset, (*VELOCITIES, *ATTITUDE))
    rotor = _rotor(dataset) if moving else None
    inflow = rotor is not None and dataset.vehicle.mass is not None and dataset.vehicle.inertia is not None
    states = [*(VELOCITIES if moving else ()), *RATES, *(ATTITUDE if have(dataset, ATTITUDE) else ())]
    drivers = (*(VELOCITIES if moving else ()), *RATES, *dataset.controls)
    lag = _flapping_lag(dataset, drivers) if moving and have(dataset, FLAPPING) else None
    flapping: FlappingKind = "none" if lag is None else "algebraic" if lag == 0 else "first order"
    places, explained = motors(dataset, find=reconstruction is not None)
    spec = ModelSpec(
        states=tuple(states),
        controls=dataset.controls,
        outputs=(
            *(c for c in OUTPUTS if _predicted(c, states, flapping, dataset)),
            *rotor_speeds(dataset),
            *(c for c in predicted_by(effects) if have(dataset, (c,))),
        ),
        reference={k: v for k, v in dataset.reference().items() if math.isfinite(v)},
        sizes=_sizes(dataset, reconstruction),
        ranges=_ranges(dataset),
        patterns={},
        control_units={c: dataset.control_specs[c].unit for c in dataset.controls},
        flapping=flapping,
        flapping_doubtful=lag is not None and 0 < lag <= DOUBTFUL,
        inflow=inflow,
        cyclic_inflow=inflow and lag is not None and lag > DOUBTFUL,
        **_declared(dataset.vehicle),
        rotor=rotor,
        inputs=measured_inputs(dataset),
        motors=places,
        found_places=explained,
        spins=spins(dataset) or (() if "N" not in (explained or {}) else tuple(m.spin for m in places)),
        effects=tuple(effects),
    )
    return _with_patterns(spec, drivers if dataset.kind == "helicopter" else ())


def _declared(vehicle: Vehicle) -> dict[str, Any]:
    """What the structure takes over from the declaration of the vehicle."""
    return {
        "gravity": vehicle.gravity,
        "air_density": vehicle.air_density,
        "mass": vehicle.mass,
        "inertia": None if vehicle.inertia is None else tuple(tuple(map(float, row)) for row in vehicle.inertia),
        "hub": None if vehicle.hub is None else _triple(vehicle.hub),
        "imu": (0.0, 0.0, 0.0) if vehicle.imu is None else _triple(vehicle.imu),
        "mass_excludes": vehicle.mass_excludes,
    }


def rival(spec: ModelSpec) -> ModelSpec | None:
    """The same structure with algebraic flapping, where the data leave open whether it lags; the likelihood decides.

    None too where an effect that was asked for needs flapping with a lag.
    """
    if not spec.flapping_doubtful:
        return None
    drivers = [c for c in spec.patterns[MOMENTS[0]] if c not in FLAPPING and c != INDUCED]
    other = _with_patterns(msgspec.structs.replace(spec, flapping="algebraic", flapping_doubtful=False), drivers)
    fits = all(obstacle(e, other) is None for e in spec.effects)
    return other if fits else None


def _with_patterns(spec: ModelSpec, drivers: Sequence[str]) -> ModelSpec:
    lagged = spec.flapping == "first order"
    columns = (*drivers, *(FLAPPING if lagged else ()), *((INDUCED,) if spec.inflow else ()))
    forces = [f for f, a in zip(FORCES, SPECIFIC_FORCES, strict=True) if "u" in spec.states or a in spec.outputs]
    patterns = dict.fromkeys((*forces, *MOMENTS), columns)
    if sticks_alone(spec):
        patterns |= {row: _commanded(row, columns) for row in patterns}
    if spec.flapping != "none":
        patterns |= dict.fromkeys(FLAPPING, columns)
    if spec.cyclic_inflow:
        patterns |= dict.fromkeys(FLAPPING[1:], (*columns, *CYCLIC))
    reference = dict(spec.reference)
    if spec.inflow:
        assert spec.rotor is not None
        assert spec.mass is not None
        reference[INDUCED] = trim_velocity(spec.rotor, spec.air_density, spec.mass, reference, spec.lift)
    reference |= _trims(spec, forces)
    if spec.cyclic_inflow:
        reference |= {wake: reference[tilt] for wake, tilt in zip(CYCLIC, FLAPPING[1:], strict=True)}
    sizes = spec.sizes | ({INDUCED: 0.1 * reference[INDUCED]} if spec.inflow else {})
    sizes |= {wake: sizes[tilt] for wake, tilt in zip(CYCLIC, FLAPPING[1:], strict=True) if spec.cyclic_inflow}
    flapping_time = FLAP_TIME if lagged else 1.0
    sizes |= {f"row.{row}": sizes[row] / flapping_time for row in FLAPPING if row in patterns}
    return msgspec.structs.replace(spec, patterns=patterns, reference=reference, sizes=sizes)


def _commanded(row: str, columns: Sequence[str]) -> tuple[str, ...]:
    """Regressors of a row where sticks command a unit that makes body rates of them, and holds these against the rest.

    A rate follows its commands and is damped; it takes nothing from the other rates or from speed. Along the body only
    drag is left, for the attitude says where thrust points; across the rotor the collective acts.
    """
    if not set(RATES) <= set(columns):
        return tuple(c for c in columns if row not in MOMENTS or c not in VELOCITIES)
    states = (*VELOCITIES, *RATES)
    if row in MOMENTS:
        rate = RATES[MOMENTS.index(row)]
        return tuple(c for c in columns if c == rate or c not in states)
    if not set(VELOCITIES) <= set(columns):
        return tuple(columns)
    rate = VELOCITIES[FORCES.index(row)]
    return tuple(c for c in columns if c == rate or (row == "Z" and c == "col"))


def sticks_alone(spec: ModelSpec) -> bool:
    """Whether sticks are all that is known of a helicopter: they command a unit that takes speed out of the moments."""
    declared = spec.mass is not None or spec.inertia is not None or spec.rotor is not None
    return not declared and not spec.motors and set(spec.control_units.values()) == {"norm"}


def _trims(spec: ModelSpec, forces: Sequence[str]) -> dict[str, float]:
    """Trim values of the rows by balance with gravity at the reference; flapping at its reference."""
    phi, theta = spec.reference.get("phi", 0.0), spec.reference.get("theta", 0.0)
    weight = (-math.sin(theta), math.cos(theta) * math.sin(phi), math.cos(theta) * math.cos(phi))
    trims = {f"{row}.trim": -spec.gravity * g for row, g in zip(FORCES, weight, strict=True) if row in forces}
    if spec.flapping == "algebraic":
        trims |= {f"{row}.trim": spec.reference[row] for row in FLAPPING}
    return trims


def _predicted(channel: str, states: Sequence[str], flapping: FlappingKind, dataset: Dataset) -> bool:
    """Whether the model predicts a channel that the data set measures."""
    if not any(dataset.facts[f].has(channel) for f in dataset.identify):
        return False
    if channel in SPECIFIC_FORCES:
        alone = dataset.kind == "multirotor"  # whose thrust has one axis
        return "u" in states or have(dataset, (channel,) if alone else SPECIFIC_FORCES)
    return channel in states or (channel in FLAPPING and flapping != "none")


def _rotor(dataset: Dataset) -> RotorSpec | None:
    """The declared rotor, where it is declared far enough to have a thrust."""
    r = dataset.vehicle.rotor
    if r is None or dataset.kind != "helicopter" or None in (r.blades, r.radius, r.chord, r.speed):
        return None
    declared = ("blades", "radius", "chord", "speed", "hinge_offset", "lock_number")
    return RotorSpec(**{n: getattr(r, n) for n in declared}, direction=r.direction or "ccw")


def _triple(values: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = values
    return float(x), float(y), float(z)


def _flapping_lag(dataset: Dataset, drivers: Sequence[str]) -> int:
    """Samples of first-order lag between cyclic flapping and what drives it that explain the flapping best."""
    flights = [dataset.flights[f] for f in dataset.some(LAGGED)]
    misfit = torch.stack([_lagged_misfit(flights, drivers, lag) for lag in LAGS])
    return LAGS[int(misfit.argmin())]


def _lagged_misfit(flights: Sequence[Flight], drivers: Sequence[str], lag: int) -> Tensor:
    """Mean log residual of a1 and b1 regressed on drivers that pass a first-order lag of so many samples."""
    passed = lagged(pad_sequence([f.bridged(drivers) for f in flights]), lag).unbind(1)
    z = [record[: f.samples] for record, f in zip(passed, flights, strict=True)]
    z = [torch.cat([c - c.mean(0), torch.ones_like(c[:, :1])], dim=1) for c in z]
    y = [f.bridged(FLAPPING[1:]) for f in flights]
    columns, response = torch.cat(z), torch.cat(y)
    columns = columns / columns.norm(dim=0).clamp_min(1e-12)
    remainder = response - columns @ least_squares(columns, response)
    return remainder.square().mean(0).log().mean()


def lagged(signal: Tensor, samples: float) -> Tensor:
    """A first-order lag of so many samples over records (T, ...), in equilibrium at their start."""
    if samples <= 0:
        return signal
    decay, records = math.exp(-1.0 / samples), signal.reshape(len(signal), -1)
    return followed(linear, records[0], records.new_full((1, 1), decay), (1.0 - decay) * records).view_as(signal)


def _sizes(dataset: Dataset, reconstruction: Reconstruction | None) -> dict[str, float]:
    """Rms excursion of every signal, force and moment over the identify flights; of a still signal its noise."""
    reference = dataset.reference()
    signals = (*VELOCITIES, *RATES, *ATTITUDE, *FLAPPING, *dataset.controls)
    sizes = {}
    for name in signals:
        if have(dataset, (name,)):
            spreads = [dataset.facts[f].spreads[name] for f in dataset.identify]
            square = sum(s.squares_about(reference[name]) for s in spreads) / sum(s.count for s in spreads)
            sizes[name] = max(math.sqrt(square), dataset.noise(name))
    rows = [f"row.{row}" for row in (*FORCES, *MOMENTS)]
    deviations = [1.0] * len(rows) if reconstruction is None else _deviations(dataset, reconstruction)
    return sizes | dict(zip(rows, deviations, strict=True))


def _deviations(dataset: Dataset, reconstruction: Reconstruction) -> list[float]:
    """Standard deviation of each force and moment over the identify flights; one where it is unknown."""
    moments = []
    for loads in (reconstruction.flights[f].specific for f in dataset.identify):
        mean = loads.nanmean(0)
        moments.append(torch.stack([(~loads.isnan()).sum(0), mean.nan_to_num(0.0), (loads - mean).square().nansum(0)]))
    count, mean, squares = torch.stack(moments, dim=1)
    between = (count * (mean - (count * mean).sum(0) / count.sum(0)).square()).sum(0)
    return ((squares.sum(0) + between) / count.sum(0)).sqrt().nan_to_num(1.0).tolist()


def _ranges(dataset: Dataset) -> dict[str, tuple[float, float]]:
    """Smallest and largest value of every signal in the identify flights."""
    ranges = {}
    for name in (*VELOCITIES, *RATES, *ATTITUDE, *dataset.controls):
        spreads = [dataset.facts[f].spreads[name] for f in dataset.identify if dataset.facts[f].has(name)]
        if spreads:
            ranges[name] = min(s.low for s in spreads), max(s.high for s in spreads)
    return ranges


def spins(dataset: Dataset) -> tuple[float, ...]:
    """Of the declared motors, +1 for counter-clockwise seen from above."""
    return tuple(1.0 if motor.spin == "ccw" else -1.0 for motor in dataset.vehicle.motors)


def motors(dataset: Dataset, find: bool) -> tuple[tuple[MotorSpec, ...], dict[str, float] | None]:
    """The motors of a multirotor as declared; else where flights say that they stand, and how well they say it.

    find : whether to look; unknown places are at the centre, so that they turn nothing.
    """
    if dataset.kind != "multirotor":
        return (), None
    declared = tuple(
        MotorSpec(position=m.position, spin=spin, thrust=m.thrust, torque_ratio=m.torque_ratio)
        for m, spin in zip(dataset.vehicle.motors, spins(dataset), strict=True)
    )
    if declared:
        return declared, None
    nowhere = Mixer(torch.zeros(len(motor_commands(dataset)), 3, dtype=torch.float64), {})
    mixer = find_mixer(dataset, rotor_speeds(dataset) or motor_commands(dataset)) if find else nowhere
    vehicle = dataset.vehicle
    return mixer.motors(usual_arm(vehicle.mass, vehicle.inertia), vehicle.frame), dict(mixer.explained)


def motor_commands(dataset: Dataset) -> tuple[str, ...]:
    """The controls that are motor commands."""
    return tuple(control for control in dataset.controls if is_motor(control))


def rotor_speeds(dataset: Dataset) -> tuple[str, ...]:
    """Channels of the rotors' speeds where every flight has all of them, one per motor command."""
    wanted = tuple(f"omega{control.removeprefix('motor')}" for control in motor_commands(dataset))
    return wanted if dataset.kind == "multirotor" and _every_flight_has(dataset, wanted) else ()


def measured_inputs(dataset: Dataset) -> tuple[str, ...]:
    """Measured quantities besides the commands that drive a multirotor: rotor speeds, battery voltage."""
    battery = ("voltage",) if dataset.kind == "multirotor" and _every_flight_has(dataset, ("voltage",)) else ()
    return (*rotor_speeds(dataset), *battery)


def _every_flight_has(dataset: Dataset, channels: tuple[str, ...]) -> bool:
    return all(facts.has(*channels) for facts in dataset.facts.values())
