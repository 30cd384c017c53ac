"""Whole processes: imports, commands, and how time and memory grow with the number of flights."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np

from benchmark.clock import interleaved, process, processor_seconds, profile
from benchmark.rows import Figure, NotMeasured
from benchmark.setting import Measured, Setting
from rotorid_torch.data.dataset import Dataset, load
from rotorid_torch.data.write import write_dataset
from rotorid_torch.run import pipeline

FEW = 10
"""Flights that larger sets are held against."""
FRESH = {
    "import": ("-c", "import rotorid_torch"),
    "import-identify": ("-c", "from rotorid_torch import identify"),
    "help": ("-m", "rotorid_torch", "--help"),
}
"""Arguments of a fresh Python."""
ASKS_FOR_HELP = """
import sys
from rotorid_torch.cli import main
try:
    main(["--help"])
finally:
    print("torch" in sys.modules, file=sys.stderr)
"""

SHARED = 16
"""Flights that ranks share."""
ROUNDS = """
import sys, time
sys.path.insert(0, sys.argv[1])
import harness
harness.malloc()
program = harness.make(harness.PEERS["B"]["cpp"], harness.references("B", 10)[0])
program()
begin = time.perf_counter()
for _ in range(60):
    program()
print(time.perf_counter() - begin)
"""


def imports(setting: Setting) -> Measured:
    """Seconds until the package, what it takes to identify, and the list of commands are there."""
    found: Measured = {}
    fresh = {name: partial(process, *arguments) for name, arguments in FRESH.items() if name in setting.wanted}
    if "import-identify" in fresh:
        fresh["torch"] = partial(process, "-c", "import torch")
    for program in fresh.values():
        program()  # the first time is the disk's
    seconds = interleaved(fresh, min(setting.repeats, 5))
    for name in setting.wanted & FRESH.keys():
        found[name] = Figure(seconds[name], "s")
    if "import-identify" in fresh:
        whole, torch = seconds["import-identify"], seconds["torch"]
        found["import-identify"] = Figure(whole, "s", f"import torch, {torch:.3g} s", whole / torch)
    if "help-torch" in setting.wanted:
        said = subprocess.run([sys.executable, "-c", ASKS_FOR_HELP], capture_output=True, text=True, check=False)
        found["help-torch"] = Figure(float(said.stderr.strip().endswith("True")), "times")
    return found


def identify(setting: Setting) -> Measured:
    """The command on the data set in a fresh process: nothing built before, and again with what it built."""
    data, runs = setting.dataset(), setting.folder / "runs"
    cache = {"ROTORID_CACHE": str(setting.folder / "cache")}
    found: Measured = {}
    runs.mkdir(exist_ok=True)
    for name in ("identify-first", "identify-warm"):
        run = runs / name
        seconds, _ = process("-m", "rotorid_torch", "identify", str(data), "--out", str(run), "--quiet", **cache)
        found[name] = Figure(seconds, "s")
        if setting.profile:
            stages = json.loads((run / "report.json").read_text())["time_s"]
            told = ", ".join(f"{stage} {spent:.2f} s" for stage, spent in stages.items() if spent is not None)
            setting.tell(f"{name}: {seconds:.2f} s, of which {told}")
    if setting.profile:
        program = partial(pipeline.identify, load(data), out=runs / "profiled")
        setting.tell(profile("identify, in this process", program, once=True))
    return found


def close_loop(setting: Setting) -> Measured:
    """The command on the data set, no draws cached, and again with those that it has made."""
    data, runs = setting.dataset(), setting.folder / "runs"
    cache = {"ROTORID_CACHE": str(setting.folder / "cache")}
    found: Measured = {}
    runs.mkdir(exist_ok=True)
    shutil.rmtree(setting.folder / "cache" / "native" / "draws", ignore_errors=True)
    for name in ("close-loop-cold", "close-loop"):
        run = runs / name
        before = processor_seconds()
        seconds, _ = process("-m", "rotorid_torch", "close-loop", str(data), "--out", str(run), "--quiet", **cache)
        found[name] = Figure(seconds, "s")
        busy, load = processor_seconds() - before, os.getloadavg()[0]
        setting.tell(f"{name}: {seconds:.1f} s, of processors {busy:.1f} s; load at its end {load:.1f}")
        if setting.profile:
            setting.tell((run / "log.txt").read_text())
    return found


def many_flights(setting: Setting, count: int) -> Measured:
    """The command on 10 flights and on many: time per flight and peak memory."""
    if count > 100 and not setting.full:
        raise NotMeasured("takes long (--full)")
    time, memory = f"flights-{count}-time", f"flights-{count}-memory"
    few, many = (_identified(setting, n) for n in (FEW, count))
    each = [seconds / n for (seconds, _), n in ((few, FEW), (many, count))]
    return {
        time: Figure(each[1], "s a flight", f"{FEW} flights, {each[0]:.3g} s a flight", each[1] / each[0]),
        memory: Figure(many[1], "MB", f"{FEW} flights, {few[1]:.0f} MB", many[1] / few[1]),
    }


def _identified(setting: Setting, count: int) -> tuple[float, float]:
    """Wall time, s, and peak memory, MB, of identifying so many flights; kept, so that 10 flights run once."""
    run = setting.folder / "runs" / f"flights-{count}"
    kept = run.with_suffix(".json")
    run.parent.mkdir(exist_ok=True)
    if not kept.exists():
        data = repeated(load(setting.dataset()), count, setting.folder / f"flights-{count}")
        command = ("-m", "rotorid_torch", "identify", str(data), "--out", str(run), "--quiet")
        cache = {"ROTORID_CACHE": str(setting.folder / "cache")}
        if count == FEW:
            process(*command, **cache)  # builds what all sizes need
        seconds, _ = process(*command, **cache)
        peak = json.loads((run / "report.json").read_text())["peak_memory_mb"]
        kept.write_text(json.dumps([seconds, peak]))
    seconds, peak = json.loads(kept.read_text())
    return seconds, peak


def repeated(dataset: Dataset, count: int, folder: Path) -> Path:
    """A data set of `count` flights to identify: those of another one again and again, each with fresh noise."""
    rng = np.random.default_rng(0)

    def arrays(name: str, noise: float) -> dict[str, np.ndarray]:
        flight = dataset.flights[name]
        made = {"time": flight.time.numpy()}
        for channel in sorted(flight.channels.keys() - {"time"}):
            more = noise * dataset.noise(channel) * rng.standard_normal(flight.samples)
            made[channel] = flight.channels[channel].numpy() + more
        return made

    names = [dataset.identify[k % len(dataset.identify)] for k in range(count)]
    flights = {f"{name}_{k}": arrays(name, 1.0) for k, name in enumerate(names)}
    return write_dataset(
        folder,
        flights | {name: arrays(name, 0.0) for name in dataset.validate},
        identify=tuple(flights),
        validate=dataset.validate,
        kind=dataset.kind,
        vehicle=dataset.vehicle,
        controls=dict(dataset.control_specs),
        channels=dict(dataset.channel_specs),
        model=dataset.settings,
    )


def ranks(setting: Setting) -> Measured:
    """Step 3 of two ranks against that of one, held against what two independent C++ processes gain."""
    if setting.anchors is None:
        raise NotMeasured("no anchors (--anchors DIR)")
    data = repeated(load(setting.dataset()), SHARED, setting.folder / "ranks")
    launch = ("-m", "torch.distributed.run", "--nproc-per-node", "2")
    alone, both = [], []
    for k in range(1 + min(setting.repeats, 2)):  # the first builds
        alone.append(_step_3(setting, data, (), f"one-{k}"))
        both.append(_step_3(setting, data, launch, f"two-{k}"))
    gain = median(alone[1:]) / median(both[1:])
    pairs = [(_anchors(setting, 1), _anchors(setting, 2)) for _ in range(3)]
    least = 2.0 * median(one for one, _ in pairs) / median(two for _, two in pairs)
    return {"ranks": Figure(gain, "times", f"two C++ processes, {least:.3g} times", gain / least)}


def _step_3(setting: Setting, data: Path, launch: tuple[str, ...], name: str) -> float:
    """Seconds that step 3 took in a run of `identify`, one thread in each process."""
    run = setting.folder / "runs" / name
    run.parent.mkdir(exist_ok=True)
    command = (*launch, "-m", "rotorid_torch", "identify", str(data), "--out", str(run), "--quiet")
    process(*command, ROTORID_THREADS="1", ROTORID_CACHE=str(setting.folder / "cache"))
    return float(json.loads((run / "report.json").read_text())["time_s"]["ml"])


def _anchors(setting: Setting, count: int) -> float:
    """Seconds that so many C++ processes side by side take for the same rounds of problem B."""
    command = [sys.executable, "-c", ROUNDS, str(setting.anchors)]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(count)]
    return max(float(p.communicate()[0].split()[-1]) for p in running)
