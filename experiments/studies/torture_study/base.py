"""What all trials begin from: small data, a warm cache, and what undisturbed commands write."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from rotorid_torch.data.write import write_dataset
from torture_study.trials import Place, copied

FLIGHTS = "dbl_lat_p,dbl_lon_p,dbl_ped_p"
FLOWN_S = 6.0
"""Length of the flights for which clean aircraft are drawn."""
EDIT = "\n# edited by hand\n"


@dataclass
class Base:
    """What all trials begin from: data, a warm cache, and what undisturbed commands write."""

    root: Path
    cpu: dict[str, float] = field(default_factory=dict)
    events: dict[str, int] = field(default_factory=dict)
    startups: dict[str, float] = field(default_factory=dict)

    @cached_property
    def rates(self) -> Path:
        """A small data set of body rates: three flights, from which all commands take seconds."""
        return _write_rates(self.root / "rates")

    @cached_property
    def log(self) -> Path:
        """A flight of it as a table."""
        file = self.root / "flight.csv"
        with np.load(self.rates / "flights" / "one.npz") as flight:
            columns = dict(flight)
        rows = np.column_stack(list(columns.values()))
        np.savetxt(file, rows, delimiter=",", header=",".join(columns), comments="")
        return file

    @cached_property
    def flown(self) -> Path:
        """A small data set of the built-in aircraft, for which clean aircraft are drawn."""
        self.undisturbed(("fly", "--out", "OUT", "--flights", FLIGHTS), "flown", seconds=FLOWN_S)
        return self.root / "flown"

    @cached_property
    def model(self) -> Path:
        """A run with a model of the rates."""
        return self.result("identify")

    @property
    def cache(self) -> Path:
        """The warm cache."""
        return self.root / "cache"

    def arguments(self, command: str, seed: int = 1) -> tuple[str, ...]:
        """A command as it is tried; OUT stands for what it writes."""
        told = {
            "fly": ("fly", "--flights", "dbl_lat_p", "--out", "OUT"),
            "import": ("import", str(self.log), "--out", "OUT", "--rate", "25" if seed == 1 else "20"),
            "simulate": ("simulate", "MODEL", str(self.rates), "--flight", "one", "--out", "OUT"),
            "draws": ("close-loop", str(self.root / "flown"), "--out", "OUT"),
        }
        given = told.get(command, (command, str(self.rates), "--out", "OUT"))
        given = tuple(str(self.model) if word == "MODEL" else word for word in given)
        return given if command == "simulate" else (*given, "--seed", str(seed))

    def result(self, command: str, seed: int = 1, over: bool = False) -> Path:
        """What the undisturbed command writes; `over` an earlier result of another seed that was edited by hand."""
        if command == "draws":
            self.flown  # noqa: B018
        name = f"{command}-{seed}{'-over' if over else ''}"
        earlier = self.earlier(command) if over else None
        self.undisturbed(self.arguments(command, seed), name, earlier)
        return self.root / name

    def startup_s(self, command: str) -> float:
        """Processor seconds in which a command refuses an input that is not there."""
        if command not in self.startups:
            note = self.root / f"{command}-startup.json"
            if not note.exists():
                missing = {str(self.rates): "missing", str(self.log): "missing", "dbl_lat_p": "missing"}
                with tempfile.TemporaryDirectory(dir=self.root) as folder:
                    place = Place(Path(folder) / "place")
                    words = [missing.get(word, word) for word in self.arguments(command)]
                    note.write_text(json.dumps(place.run(filled(words, place.out)).cpu_s))
            self.startups[command] = json.loads(note.read_text())
        return self.startups[command]

    def earlier(self, command: str) -> Path:
        """A result of another seed; where it is a data set, its declaration has been edited by hand."""
        place = self.root / f"{command}-earlier"
        if not place.exists():
            copied(self.result(command, 2), place)
            declaration = place / "dataset.toml"
            if declaration.exists():
                declaration.write_text(declaration.read_text() + EDIT)
        return place

    def undisturbed(
        self, arguments: Sequence[str], name: str, earlier: Path | None = None, seconds: float | None = None
    ) -> None:
        """Run a command once, keep what it writes under a name, and note how long it takes; once for all studies."""
        note = self.root / f"{name}.json"
        if not note.exists():
            place = Place(Path(tempfile.mkdtemp(prefix="undisturbed-", dir=self.root)) / "place")
            if earlier is not None:
                copied(earlier, place.out)
            place.cache, place.seconds = self.cache, seconds or place.seconds
            ended = place.run(filled(arguments, place.out))
            if ended.code or ended.lines:
                raise RuntimeError(f"{name}: an undisturbed run ends with {ended.code}: {ended.lines}")
            if earlier is None and not seconds:  # once more with a warm cache
                shutil.rmtree(place.out) if place.out.is_dir() else place.out.unlink()
                ended = place.run(filled(arguments, place.out))
            shutil.rmtree(self.root / name, ignore_errors=True)
            place.out.rename(self.root / name)
            shutil.rmtree(place.root.parent)
            note.write_text(json.dumps({"cpu_s": ended.cpu_s, "events": ended.events}))
        told = json.loads(note.read_text())
        self.cpu[name], self.events[name] = told["cpu_s"], told["events"]


def filled(arguments: Sequence[str], out: Path) -> list[str]:
    """The arguments of a command that writes to a place."""
    return [str(out) if word == "OUT" else word for word in arguments]


def _write_rates(folder: Path) -> Path:
    """Body rates that answer to doublets at first order, with noise; 6 s at 25 Hz each."""
    if (folder / "dataset.toml").exists():
        return folder
    rng, dt, samples = np.random.default_rng(0), 0.04, 150
    time_s, flights = dt * np.arange(samples), {}
    for k, name in enumerate(("one", "two", "three")):
        sticks = np.zeros((samples, 3))
        for axis in range(3):
            begin = 25 + 30 * ((axis + k) % 3)
            sticks[begin : begin + 12, axis], sticks[begin + 12 : begin + 24, axis] = 0.03, -0.03
        rates = np.zeros((samples, 3))
        for n in range(1, samples):
            rates[n] = rates[n - 1] + dt * (np.array([8.0, 6.0, 5.0]) * sticks[n - 1] - [3.0, 1.5, 1.0] * rates[n - 1])
        noisy = rates + 0.002 * rng.standard_normal(rates.shape)
        columns = dict(zip(("lat", "lon", "ped", "p", "q", "r"), np.hstack([sticks, noisy]).T, strict=True))
        flights[name] = {"time": time_s, **columns, "col": np.zeros(samples)}
    noise = {c: {"noise": 0.002, "bias": "none"} for c in "pqr"}
    controls = {c: {"unit": "rad", "noise": 1e-6} for c in ("lat", "lon", "ped", "col")}
    return write_dataset(
        folder,
        flights,
        identify=["one", "two"],
        validate=["three"],
        channels=noise,
        controls=controls,
        vehicle={"imu": [0.0, 0.0, 0.0]},
    )
