"""Does a model fly as somebody else's simulator does? Identified from data sets in a folder, judged on unseen flights.

Every folder below DATA with a dataset.toml is identified; the table holds J of free runs on flights that were not used,
beside J of the sensors' noise alone and of holding trim. Pictures and parameters go to TensorBoard.

Expected: on flights of J-GenHel, JSBSim and helisim J is nearer to the noise than to holding trim. A set takes 10 to
60 s of a processor; `--quick` flies the built-in aircraft for want of another.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
import tyro
from rich.console import Console
from rich.table import Table
from torch.utils.tensorboard import SummaryWriter

import rotorid_torch as rotorid


@dataclass
class Args:
    """Which data sets."""

    data: Path = Path(os.environ.get("ROTORID_SHARED", "../shared")) / "flightdata"
    """Folder of data sets."""
    sets: tuple[str, ...] = ("uh60-hover", "uh60-60kt", "ah1-hover", "uh60b-hover")
    """Names of their folders; those that are missing are left out."""
    out: Path = Path("runs/other_simulators")
    """TensorBoard records and a RUN with report of each set."""
    seed: int = 0
    quick: bool = False
    """Short flights of the built-in aircraft."""


def unseen(run: rotorid.Run) -> dict[str, float]:
    """Root mean squares over the flights that were not used: J, of noise alone, of holding trim."""
    flights = [f for f in run.fit.flights.values() if f.list != "identify"]
    return {
        name: math.sqrt(sum(getattr(f, name) ** 2 for f in flights) / len(flights))
        for name in ("J", "J_noise", "J_trim")
    }


def main(args: Args) -> None:
    """Identify each set, print the table, and end with one JSON line."""
    torch.set_num_threads(1)
    if args.quick:
        some = ("f321_lon", "f321_lat", "dbl_col_p", "dbl_lon_n", "sweep_col")
        sets = {"built-in": rotorid.fly(None, seed=args.seed, flights=some, seconds=8.0).dataset()}
    else:
        sets = {n: rotorid.load(args.data / n) for n in args.sets if (args.data / n / "dataset.toml").exists()}
    writer = SummaryWriter(str(args.out / "tensorboard"))
    writer.add_text("settings", json.dumps(asdict(args), default=str))
    table, scores = Table("set", "J", "noise", "holding trim", title="Free runs of unseen flights"), {}
    for k, (name, data) in enumerate(sets.items()):
        run = rotorid.identify(data, seed=args.seed, out=args.out / name)
        scores[name] = unseen(run)
        table.add_row(name, *(f"{J:.3f}" for J in scores[name].values()))
        writer.add_scalars("J of unseen flights", scores[name], k)
        for title, figure in run.plot().items():
            writer.add_figure(f"{name}/{title}", figure)
    writer.close()
    Console(stderr=True).print(table)
    print(json.dumps(scores))


if __name__ == "__main__":
    main(tyro.cli(Args))
