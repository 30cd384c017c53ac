"""Step 1: forces and moments, and the flight's own channels cleaned of noise, from whatever channels a flight has.

The filter and smoother of `unscented_filter` on the six-degree-of-freedom equations of `motion`; time constants and
powers of the forces are those of `gauss_markov`, found on the identify flights and held for all.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from torch import Tensor

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.core.names import ATTITUDES, RATES, VELOCITIES, unit
from rotorid_torch.core.processes.device import moved, working_on
from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.on_demand import OnDemand
from rotorid_torch.data.use.pictures import over
from rotorid_torch.identification.reconstruct import sensor_biases
from rotorid_torch.identification.reconstruct.filter_problem import Filtered
from rotorid_torch.identification.reconstruct.force_noise import (
    SEARCHED,
    Biases,
    ForceNoise,
    LocalNoise,
    adapted,
    find_force_noise,
)
from rotorid_torch.identification.reconstruct.motion import AXES, GaussMarkovForces, Motion
from rotorid_torch.identification.reconstruct.observability import left_out, observable
from rotorid_torch.identification.reconstruct.sigma_points import ProcessNoise
from rotorid_torch.identification.reconstruct.unscented_filter import SampledSystem, filter_and_smooth

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UNSEEN_SD = dict.fromkeys((*RATES, *ATTITUDES), 0.3)
"""Standard deviation of a first state that no channel sees then, rad and rad/s; 10 m and m/s for the others."""
WANDER_S = 1.0
"""Time in which a vibration line's amplitude may change by its own size."""
ADAPTED = 160_000
"""Samples whose forces' powers are adapted at once."""
TOGETHER = 32_000
"""Samples that are filtered at once: what the filter writes of them takes two hundred megabytes."""


@dataclass(frozen=True, eq=False, repr=False)
class ReconstructedFlight:
    """One flight after step 1.

    channels, channel_sd : smoothed states by channel name, (T,) each, and their standard deviations.
    specific : (T, 6) X Y Z over mass (m/s2), L M N over the inertia (rad/s2); NaN where no channel sees it.
    specific_covariance : (T, 6, 6) of their errors.
    loads, loads_sd : (T, 6) the same as forces and moments in `Reconstruction.units`.
    innovations : by channel, (T,), measured minus predicted, in standard deviations.
    biases : constants taken off the sensors beforehand, by channel.
    """

    name: str
    time: Tensor
    channels: Mapping[str, Tensor]
    channel_sd: Mapping[str, Tensor]
    specific: Tensor
    specific_covariance: Tensor
    loads: Tensor
    loads_sd: Tensor
    innovations: Mapping[str, Tensor]
    log_likelihood: float
    biases: Mapping[str, float]

    def __repr__(self) -> str:
        return f"Reconstructed flight {self.name}: {len(self.time)} samples; {', '.join(self.channels)}, X Y Z L M N"

    @property
    def forces(self) -> Tensor:
        """X Y Z (T, 3)."""
        return self.loads[:, :3]

    @property
    def moments(self) -> Tensor:
        """L M N (T, 3)."""
        return self.loads[:, 3:]


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction:
    """Step 1 on all flights of a data set; of many, those used last are in memory and the others on disk.

    units : of X Y Z L M N: N and N m where mass and inertia are declared, else m/s2 and rad/s2 (per mass, per inertia).
    noise : time constants and powers of the forces. lines : Hz of the vibration lines by channel. notes : for people.
    """

    flights: Mapping[str, ReconstructedFlight]
    units: Mapping[str, str]
    noise: ForceNoise
    lines: Mapping[str, float]
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return "\n".join((f"Reconstruction of {len(self.flights)} flights: X Y Z L M N", *self.notes))

    def __getitem__(self, name: str) -> ReconstructedFlight:
        """A flight by its name; KeyError with those there are."""
        if name not in self.flights:
            raise KeyError(f"there is no flight {name!r}, but {', '.join(self.flights)}")
        return self.flights[name]

    def arrays(self, name: str) -> dict[str, np.ndarray]:
        """One flight as plain arrays: time, smoothed channels, X ... N in `units`, and sd_ of each; KeyError: none."""
        flight = self[name]
        loads = {axis: flight.loads[:, i] for i, axis in enumerate(AXES)}
        sd = {axis: flight.loads_sd[:, i] for i, axis in enumerate(AXES)}
        every = {**flight.channels, **loads}
        spread = {f"sd_{key}": value for key, value in {**flight.channel_sd, **sd}.items()}
        return {"time": flight.time.numpy(), **{key: value.numpy() for key, value in {**every, **spread}.items()}}

    def plot(self) -> dict[str, Figure]:
        """Smoothed channels, forces and moments of each flight over time as a matplotlib figure, by its name."""
        figures = {}
        for name in self.flights:
            flight = self[name]
            every = {**flight.channels, **dict(zip(AXES, flight.loads.mT, strict=True))}
            columns = {f"{key}, {self.units.get(key) or unit(key)}": values for key, values in every.items()}
            figures[name] = over(name, ("time, s", flight.time), columns)
        return figures


def reconstruct(dataset: Dataset, *, ranks: Ranks = ALONE, device: str = "cpu") -> Reconstruction:
    """Forces, moments and smoothed channels of every flight, with their covariance.

    Missing samples and channels are skipped exactly. Constant errors of accelerometers without velocity and attitude to
    tell them are part of the forces' trim. Flights are spread over the ranks; each gets all of them. Filter and
    smoother run on the device.

    Raises
    ------
    InputError : a flight lacks body rates.

    Source: Jategaonkar, Flight Vehicle System Identification, ch. 10 (flight path reconstruction).
    """
    arguments.instance(Argument("reconstruct", "dataset"), dataset, Dataset, "a Dataset: load or Dataset.from_arrays")
    dataset.require_rates()
    states, outputs = observable(dataset)
    searched = dataset.some(SEARCHED)
    lines = sensor_biases.vibration_lines(dataset, searched, outputs)
    biases = {flight.name: sensor_biases.kinematic_biases(dataset, flight) for flight in dataset.flights.values()}
    hertz = {channel: hertz for channel, (hertz, _) in lines.items()}
    noise = find_force_noise(dataset, biases, hertz)
    sensors = SensorDisturbances(biases, lines, sensor_biases.kinematic_disagreement(dataset, searched, biases))
    states = (*states, *(f"{c} {part}" for c in lines for part in ("cos", "sin")))
    flights = OnDemand[ReconstructedFlight](dataset.flights, costly=True)

    def reconstructed(names: Sequence[str], local: LocalNoise) -> list[ReconstructedFlight]:
        tau, trim = torch.as_tensor(noise.tau), torch.as_tensor(local.trim)[:, None, :]
        motion = _motion(dataset, names, (states, outputs), GaussMarkovForces(tau, trim), hertz)
        with torch.no_grad():
            got = _filter(dataset, names, motion, local, sensors, device)
        batch = Batch(motion, got, local)
        return [_flight(dataset, batch, i, name, biases[name]) for i, name in enumerate(names)]

    def in_groups(flights: Sequence[str]) -> Iterator[list[ReconstructedFlight]]:
        for many in _groups(dataset, flights, ADAPTED):
            local = adapted(dataset, many, noise, biases, hertz)
            for names in _groups(dataset, many, TOGETHER):
                yield reconstructed(names, local.pick([many.index(name) for name in names]))

    for flight in ranks.exchange(in_groups(ranks.mine(tuple(dataset.flights)))):
        flights.keep(flight.name, flight)
    return Reconstruction(flights, _units(dataset), noise, hertz, _notes(dataset, states, biases, lines))


class SensorDisturbances(NamedTuple):
    """What sensors add: constants by flight and channel, lines of vibration (Hz, rms), and random walks by channel."""

    biases: Biases
    lines: Mapping[str, tuple[float, float]]
    wander: Mapping[str, float]


def _groups(dataset: Dataset, names: Iterable[str], most: int) -> Iterator[list[str]]:
    """Flights of about the same length, as many as have so many samples together."""
    group: list[str] = []
    for name in sorted(names, key=lambda name: dataset.facts[name].samples):
        if group and (len(group) + 1) * dataset.facts[name].samples > most:
            yield group
            group = []
        group.append(name)
    yield group


def _motion(
    dataset: Dataset,
    names: Sequence[str],
    names_of: tuple[tuple[str, ...], tuple[str, ...]],
    forces: GaussMarkovForces,
    lines: Mapping[str, float],
) -> Motion:
    """The filter's model of some flights, for names of states and outputs."""
    dt = torch.tensor([dataset.facts[name].dt for name in names], dtype=torch.float64)[:, None, None]
    return Motion.of(dataset.vehicle, *names_of, forces, dt, lines)


def _filter(
    dataset: Dataset, names: Sequence[str], motion: Motion, noise: LocalNoise, sensors: SensorDisturbances, device: str
) -> Filtered:
    """Some flights as one batch; shorter ones end in missing samples."""
    biases, lines, wander = sensors
    inputs = motion.inputs(torch.tensor([dataset.facts[name].samples for name in names]))
    outputs = torch.full((*inputs.shape[:2], len(motion.outputs)), torch.nan, dtype=torch.float64)
    for i, flight in enumerate(dataset.flights[name] for name in names):
        offset = torch.tensor([biases[flight.name].get(c, 0.0) for c in motion.outputs], dtype=torch.float64)
        outputs[i, : flight.samples] = flight.stack(motion.outputs) - offset
    sensor = torch.tensor([dataset.noise(name) for name in motion.outputs], dtype=torch.float64)
    mean, cov = _prior(motion, outputs, sensor, noise, lines)
    shape, constant = _noise_shapes(motion, lines, wander)
    rows, columns = torch.triu(shape.abs().sum(dim=(0, 1)) + constant.sum(dim=0)).nonzero(as_tuple=True)
    power = torch.as_tensor(noise.power)[: inputs.shape[1] - 1]
    entries = torch.einsum("tfi,fin->ftn", power, shape[..., rows, columns]) + constant[:, None, rows, columns]
    lasting = inputs[:, :-1, -1:] > 0.0
    process = ProcessNoise(len(motion.states), rows, columns, entries * lasting)
    arguments = (mean, cov), process, torch.diag(sensor.square()), inputs, outputs
    motion, arguments = moved((motion, arguments), device)
    with working_on(device):
        return moved(filter_and_smooth(SampledSystem(motion.rates, motion.measure, *arguments, 1.0)), "cpu")


def _prior(
    motion: Motion, outputs: Tensor, sensor: Tensor, noise: LocalNoise, lines: Mapping[str, tuple[float, float]]
) -> tuple[Tensor, Tensor]:
    """First sample's state: what the channels say first, with ten times their noise; forces about their trim."""
    mean = torch.zeros(len(outputs), len(motion.states), dtype=torch.float64)
    unseen = torch.tensor([UNSEEN_SD.get(name, 10.0) for name in motion.states], dtype=torch.float64)
    sd = unseen.expand_as(mean).clone()
    for j, name in enumerate(motion.states):
        if name in AXES:
            mean[:, j] = motion.trim[:, 0, AXES.index(name)]
            sd[:, j] = torch.as_tensor(noise.spread[:, AXES.index(name)])
        elif name in motion.outputs:
            i = motion.outputs.index(name)
            measured = ~outputs[..., i].isnan()
            first = outputs[..., i].gather(-1, measured.to(torch.int8).argmax(dim=-1, keepdim=True))[..., 0]
            mean[:, j] = first.nan_to_num(nan=0.0)
            sd[:, j] = torch.where(measured[:, 0], 10.0 * sensor[i], sd[:, j])
        elif " " in name:
            sd[:, j] = lines[name.split()[0]][1]
    return mean, torch.diag_embed(sd.square())


def _noise_shapes(
    motion: Motion, lines: Mapping[str, tuple[float, float]], wander: Mapping[str, float]
) -> tuple[Tensor, Tensor]:
    """Covariance per unit of each axis' power [F, 6, n, n] (the force and the speed it drives), and the lines' own."""
    flights, n = motion.dt.shape[0], len(motion.states)
    dt = motion.dt[:, 0, 0]
    shape, constant = (torch.zeros(flights, *more, n, n, dtype=torch.float64) for more in ((6,), ()))
    for i, (axis, driven) in enumerate(zip(AXES, (*VELOCITIES, *RATES), strict=True)):
        if axis not in motion.states:
            continue
        f = motion.states.index(axis)
        shape[:, i, f, f] = dt
        if driven in motion.states:
            s = motion.states.index(driven)
            shape[:, i, s, s] = dt**3 / 3.0
            shape[:, i, s, f] = shape[:, i, f, s] = dt.square() / 2.0
    for channel, power in wander.items():
        if channel in motion.states:
            j = motion.states.index(channel)
            constant[:, j, j] = power * dt
    for channel, (_, rms) in lines.items():
        first = motion.states.index(f"{channel} cos")
        for j in (first, first + 1):
            constant[:, j, j] = rms**2 * dt / WANDER_S
    return shape, constant


class Batch(NamedTuple):
    """Flights that were filtered together."""

    motion: Motion
    filtered: Filtered
    noise: LocalNoise


def _flight(dataset: Dataset, batch: Batch, i: int, name: str, biases: Mapping[str, float]) -> ReconstructedFlight:
    """One flight of a batch, free of it."""
    motion, got, noise = batch
    time, T = dataset.flights[name].time, dataset.facts[name].samples
    assert got.smoothed_means is not None
    assert got.smoothed_covariances is not None
    mean, cov = got.smoothed_means[i, :T], got.smoothed_covariances[i, :T]
    names = [state for state in motion.states if state not in AXES and " " not in state]
    deviation = cov.diagonal(dim1=-2, dim2=-1).sqrt()
    specific = torch.full((T, 6), torch.nan, dtype=torch.float64)
    covariance = torch.full((T, 6, 6), torch.nan, dtype=torch.float64)
    axes = [axis for axis in AXES if axis in motion.states and noise.excited[i, AXES.index(axis)]]
    place, index = [AXES.index(axis) for axis in axes], [motion.states.index(axis) for axis in axes]
    scale = torch.as_tensor(noise.variance_scale[:T, i]).sqrt()
    specific[:, place] = mean[:, index]
    block = cov[:, index][:, :, index] * scale[:, place, None] * scale[:, None, place]
    covariance[:, torch.tensor(place)[:, None], torch.tensor(place)] = block
    loads, sd = _loads(dataset, specific, covariance)
    white = got.innovations[i, :T] / got.innovation_covariances[i, :T].diagonal(dim1=-2, dim2=-1).sqrt()
    return ReconstructedFlight(
        name=name,
        time=time,
        channels={state: mean[:, motion.states.index(state)].clone() for state in names},
        channel_sd={state: deviation[:, motion.states.index(state)].clone() for state in names},
        specific=specific,
        specific_covariance=covariance,
        loads=loads,
        loads_sd=sd,
        innovations={output: white[:, j].clone() for j, output in enumerate(motion.outputs)},
        log_likelihood=float(got.log_likelihood[i]),
        biases=biases,
    )


def _loads(dataset: Dataset, specific: Tensor, covariance: Tensor) -> tuple[Tensor, Tensor]:
    """Forces and moments (T, 6) and their standard deviations from those per mass and inertia."""
    vehicle = dataset.vehicle
    mass = vehicle.mass or 1.0
    eye = torch.eye(3, dtype=torch.float64)
    inertia = eye if vehicle.inertia is None else torch.tensor(vehicle.inertia, dtype=torch.float64)
    moment_covariance = inertia @ covariance[:, 3:, 3:] @ inertia.mT
    variances = [covariance[:, :3, :3] * mass**2, moment_covariance]
    sd = torch.cat([part.diagonal(dim1=-2, dim2=-1).sqrt() for part in variances], dim=-1)
    return torch.cat([specific[:, :3] * mass, specific[:, 3:] @ inertia.mT], dim=-1), sd


def _units(dataset: Dataset) -> dict[str, str]:
    force = "m/s²" if dataset.vehicle.mass is None else "N"
    moment = "rad/s²" if dataset.vehicle.inertia is None else "N m"
    return {axis: force if i < 3 else moment for i, axis in enumerate(AXES)}


def _notes(
    dataset: Dataset, states: Collection[str], biases: Biases, lines: Mapping[str, tuple[float, float]]
) -> tuple[str, ...]:
    """What a reader of the result must know, in plain words."""
    notes = []
    if dataset.vehicle.mass is None:
        notes.append("no mass declared: X Y Z are specific forces, m/s²; declare vehicle.mass for newtons")
    if dataset.vehicle.inertia is None:
        notes.append("no inertia declared: L M N are angular accelerations, rad/s²; declare vehicle.inertia for N m")
    untold = left_out(dataset, states)
    if untold:
        notes.append(f"the channels do not tell {' '.join(untold)}: left out of the reconstruction")
    if lines:
        every = ", ".join(f"{channel} at {hertz:.1f} Hz ({rms:.2g} rms)" for channel, (hertz, rms) in lines.items())
        notes.append(f"vibration was taken out of the motion: {every}")
    bias_values = biases.values()
    largest = {name: max(abs(b[name]) for b in bias_values if name in b) for name in dict.fromkeys(chain(*bias_values))}
    if largest:
        constants = ", ".join(f"{name} up to {value:.2g} {unit(name)}" for name, value in largest.items())
        notes.append(f"constant sensor errors that the kinematics show were taken off, flight by flight: {constants}")
    if len(dataset.identify) > SEARCHED:
        searched = f"{SEARCHED} of the {len(dataset.identify)} identify flights, spread over the list"
        notes.append(f"how strongly and fast the forces change was found from {searched}; it holds for all")
    return tuple(notes)
