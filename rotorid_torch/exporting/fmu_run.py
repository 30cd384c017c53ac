"""The free run of an exported FMU on a flight, by fmpy: the FMU's code alone, no model of ours."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import c_double, c_int, c_uint
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from torch import Tensor

from rotorid_torch.core.storage.atomic import scratch_folder
from rotorid_torch.core.storage.files import read_file
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.errors import InputError
from rotorid_torch.exporting.description import CONTROL, HOLD, OUTPUT, SLOPE, START, STATE, STEP
from rotorid_torch.exporting.fmu import FACTS
from rotorid_torch.validate.free_run import Windows, fitted_start, measured_start

EXPECTED = "an FMU that rotorid export wrote"
LARGEST = 64 * 2**20
"""Bytes of an FMU at most."""


class StateFacts(msgspec.Struct, frozen=True):
    """A state, and the channel at whose measured value it starts."""

    name: str
    unit: str
    channel: str | None = None


class FmuFacts(msgspec.Struct, frozen=True):
    """What an exported FMU says of its model, see `fmu`."""

    format: int
    title: str
    body: tuple[str, ...]
    states: tuple[StateFacts, ...]
    settled: tuple[str, ...]
    controls: tuple[str, ...]
    outputs: tuple[str, ...]
    reference: dict[str, float]
    ranges: dict[str, tuple[float, float]]


def read_facts(path: str | Path) -> FmuFacts:
    """What an FMU says of itself.

    Raises InputError: it is not there, or is no FMU that rotorid wrote.
    """
    read_file(path, EXPECTED, LARGEST)
    try:
        with zipfile.ZipFile(path) as archive:
            return msgspec.json.decode(archive.read(FACTS), type=FmuFacts)
    except (zipfile.BadZipFile, KeyError, msgspec.MsgspecError, json.JSONDecodeError, OSError):
        raise InputError(path, "", f"holds no {FACTS}", EXPECTED) from None


@dataclass(frozen=True)
class Span:
    """A piece of a flight: first sample, and how many."""

    first: int
    samples: int


def fly_fmu(path: str | Path, facts: FmuFacts, dataset: Dataset, flight: str, span: Span) -> dict[str, np.ndarray]:
    """Free run by name: "time" (T,) s, states and outputs (T,), SI; as `run.saved_model.simulate` gives of a model.

    Raises InputError: fmpy is not installed, or the FMU is for another system.
    """
    record = dataset.flights[flight]
    inside = slice(span.first, span.first + span.samples)
    controls = record.bridged(facts.controls)
    measured = record.stack(facts.outputs)[inside]
    noise = torch.tensor([dataset.noise(c) for c in facts.outputs], dtype=torch.float64)
    records = controls[None, inside], measured[None], noise, torch.zeros(1, 0)
    pieces = Windows(record.dt, (flight,), (span.first,), *records)
    with _opened(path, facts, record.dt) as machine:
        machine.wait(controls[: span.first + 1])
        starts = {s.name: measured_start(record, s.channel, span.first) for s in facts.states}

        def outputs_of(bodies: Tensor, samples: int) -> Tensor:
            return machine.outputs(bodies, pieces.controls[0, :samples], starts)

        reference = {n: facts.reference[n] for n in facts.body}
        start = fitted_start(outputs_of, reference, facts.outputs, pieces)
        states, outputs = machine.fly(start[0].tolist(), pieces.controls[0], starts)
    result = {"time": record.time[inside].numpy()}
    result |= {s.name: states[:, k] for k, s in enumerate(facts.states)}
    return result | {n: outputs[:, k] for k, n in enumerate(facts.outputs)}


@contextmanager
def _opened(path: str | Path, facts: FmuFacts, dt: float) -> Iterator[_Machine]:
    """An instance of the FMU that holds its states."""
    try:
        import fmpy
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave
    except ImportError:
        raise InputError(path, "", "fmpy is not installed", "pip install 'rotorid-torch[fmu]'") from None
    with scratch_folder() as folder:
        fmpy.extract(str(path), str(folder))
        described = fmpy.read_model_description(str(folder), validate=False)
        arguments = {"guid": described.guid, "unzipDirectory": str(folder), "instanceName": "free run"}
        assert described.coSimulation is not None
        arguments["modelIdentifier"] = described.coSimulation.modelIdentifier
        three = str(described.fmiVersion).startswith("3")
        try:
            slave = (FMU3Slave if three else FMU2Slave)(**arguments)
        except Exception as error:  # fmpy raises plain exceptions
            said = str(error).partition("\n")[0][:120]
            raise InputError(path, "binaries", f"cannot be loaded here ({said})", "an FMU of this system") from None
        machine = _Machine(slave, facts, dt, three)
        machine.begin()
        try:
            yield machine
        finally:
            slave.freeInstance()


class _Machine:
    """An FMU of either version: it waits with its states held, and flies from where it waits as often as asked."""

    def __init__(self, slave: Any, facts: FmuFacts, dt: float, three: bool) -> None:
        self.slave, self.facts, self.dt, self.three = slave, facts, dt, three
        self.inputs = [CONTROL + k for k in range(len(facts.controls))]
        self.set_numbers = slave.setFloat64 if three else slave.setReal
        read = [STATE + k for k in range(len(facts.states))] + [OUTPUT + k for k in range(len(facts.outputs))]
        n, m = len(self.inputs), len(read)
        places, ones = (c_uint * m)(*read), (c_int * n)(*[1] * n)
        if three:
            slopes = (c_uint * n)(*(SLOPE + k for k in range(n)))
            self._turn = lambda values: slave.fmi3SetFloat64(slave.component, slopes, n, values, n)
            self._read = lambda values: slave.fmi3GetFloat64(slave.component, places, m, values, m)
        else:
            inputs = (c_uint * n)(*self.inputs)
            self._turn = lambda values: slave.fmi2SetRealInputDerivatives(slave.component, inputs, n, ones, values)
            self._read = lambda values: slave.fmi2GetReal(slave.component, places, m, values)
        self.time, self.waited, self.waiting, self.width = 0.0, 0.0, None, m

    def begin(self) -> None:
        slave = self.slave
        slave.instantiate()
        self.set_numbers([STEP], [self.dt])
        slave.setBoolean([HOLD], [True])
        if not self.three:
            slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()

    def wait(self, controls: Tensor) -> None:
        """Let the controls [T, nu] pass, the states held."""
        self.set_numbers(self.inputs, controls[0].tolist())
        self.slave.exitInitializationMode()
        for slopes in self._slopes(controls):
            self._step(slopes)
        self.waited = self.time
        self.waiting = self.slave.getFMUState() if self.three else self.slave.getFMUstate()

    def _slopes(self, controls: Tensor) -> list[Any]:
        """How fast the controls [T, nu] change within each step; so they are linear between samples."""
        return _rows_of(np.diff(controls.numpy(), axis=0) / self.dt)

    def _step(self, slopes: Any) -> None:
        self._turn(slopes)
        self.slave.doStep(self.time, self.dt)
        self.time += self.dt

    def fly(self, body: list[float], controls: Tensor, starts: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """States [T, nx] and outputs [T, ny] from body states, under controls [T, nu]."""
        self.time = self.waited
        (self.slave.setFMUState if self.three else self.slave.setFMUstate)(self.waiting)
        names = [s.name for s in self.facts.states]
        values = dict(zip(self.facts.body, body, strict=True)) | {n: v for n, v in starts.items() if not math.isnan(v)}
        self.set_numbers([START + names.index(n) for n in values], [*values.values()])
        self.set_numbers(self.inputs, controls[0].tolist())
        whole = np.empty((len(controls), self.width))
        first, *rows = _rows_of(whole)
        self._read(first)
        self.slave.setBoolean([HOLD], [False])
        for slopes, row in zip(self._slopes(controls), rows, strict=True):
            self._step(slopes)
            self._read(row)
        return whole[:, : len(names)], whole[:, len(names) :]

    def outputs(self, trials: Tensor, controls: Tensor, starts: dict[str, float]) -> Tensor:
        """Outputs [K, 1, T, ny] from body states [K, 1, n]."""
        runs = [self.fly(body.tolist(), controls, starts)[1] for body in trials[:, 0]]
        return torch.from_numpy(np.stack(runs))[:, None]


def _rows_of(table: np.ndarray) -> list[Any]:
    """Rows of a table in memory, as a foreign function takes them; they keep the table."""
    length, width = table.shape
    return list((c_double * width * length).from_buffer(np.ascontiguousarray(table))) if length else []
