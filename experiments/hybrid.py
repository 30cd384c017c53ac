"""Physics, effects and a network trained together on windows of flights: a script to copy and to change.

The model that `identify` finds gets a network that sees velocities, rates and controls and adds to forces and moments.
Adam moves its weights on free runs of two seconds, several hundred windows an epoch, the physics beside it more slowly.
Expected: free runs of flights that were not trained on come nearer to the measured ones, most of them in the first
epochs. On the UH-60 in hover an epoch of eight flights takes about a second on one core.
"""

from __future__ import annotations

import json
import os
import random
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
import tyro
from torch import Tensor, nn
from torch.utils.data import DataLoader
from torch.utils.tensorboard import SummaryWriter

import rotorid_torch as rotorid
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values
from rotorid_torch.effects.registry import register
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.model.save import save

ROWS = ("X", "Y", "Z", "L", "M", "N")


@dataclass
class Args:
    """Which flights, and how long to train."""

    data: Path = Path(os.environ.get("ROTORID_SHARED", "../shared")) / "flightdata" / "uh60-hover"
    """A data set; short flights of the built-in aircraft where it is not there."""
    out: Path = Path("runs/hybrid")
    """TensorBoard records and model.pt."""
    epochs: int = 20
    seconds: float = 2.0
    """Length of a window."""
    batch: int = 32
    rate: float = 3e-3
    """Step of the weights; the physics moves by a hundredth of it, in shares of each parameter's size."""
    seed: int = 0
    quick: bool = False
    """Short flights of the built-in aircraft, two epochs."""


@register
class NetworkForces(Effect):
    """Forces and moments by a network, zero before it is trained, bounded by the rms of each row."""

    id, stage, role, weight_sd = "hybrid.network", Stage.FORCES, Role.LEARNT, 0.5
    reference: Tensor
    size: Tensor
    bound: Tensor

    def __init__(self, spec: ModelSpec) -> None:
        super().__init__()
        self.inputs = tuple(n for n in ("u", "v", "w", "p", "q", "r", *spec.controls) if n in spec.sizes)
        last = nn.Linear(32, len(ROWS))
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.net = nn.Sequential(nn.Linear(len(self.inputs), 32), nn.Tanh(), last)
        self.register_buffer("reference", torch.tensor([spec.reference.get(n, 0.0) for n in self.inputs]))
        self.register_buffer("size", torch.tensor([max(spec.sizes[n], 1e-6) for n in self.inputs]))
        self.register_buffer("bound", torch.tensor([spec.sizes.get(f"row.{r}", 1.0) for r in ROWS]))

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> NetworkForces:
        """With inputs and outputs scaled as the flights are."""
        return cls(spec)

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the network's forces (m/s2) and moments (rad/s2)."""
        out = self.bound * torch.tanh(self.net((frame.stack(self.inputs) - self.reference) / self.size))
        return frame.add(force=out[..., :3], moment=out[..., 3:]), x


Window = tuple[rotorid.Flight, float]


def windows(data: rotorid.Dataset, names: tuple[str, ...], seconds: float, every: float) -> list[Window]:
    """Flights and starts, a start every so many seconds."""
    flights = [data.flights[name] for name in names]
    return [(f, every * k) for f in flights for k in range(int((float(f.time[-1]) - seconds) / every) + 1)]


def cost(model: Model, batch: list[Window], seconds: float, noise: Tensor) -> Tensor:
    """Mean squared error of free runs in units of the sensors' noise."""
    flights, starts = zip(*batch, strict=True)
    return (model.free_run(flights, starts, seconds).residual / noise).square().mean()


def main(args: Args) -> None:
    """Identify the physics, train the network beside it, save both; ends with one JSON line."""
    random.seed(args.seed)
    torch.manual_seed(args.seed)
    here = args.data.exists() and not args.quick
    data = rotorid.load(args.data) if here else rotorid.fly(None, seed=args.seed, seconds=6.0).dataset()
    run = rotorid.identify(data, seed=args.seed)
    spec = run.spec.with_effects(NetworkForces.id)
    model = build(spec)
    model.start_from(run.model.named_values)
    noise = torch.tensor([data.noise(c) for c in model.body.outputs])
    train = windows(data, data.identify, args.seconds, 0.25)
    unseen = windows(data, data.validate, args.seconds, 1.0)
    groups = {"network": [], "physics": []}
    for name, parameter in model.named_parameters():
        groups["network" if name.startswith(NetworkForces.id) else "physics"].append(parameter)
    physics = [{"params": [p], "lr": 1e-2 * args.rate * float(p.detach().abs())} for p in groups["physics"]]
    adam = torch.optim.Adam([{"params": groups["network"]}, *physics], lr=args.rate)
    writer = SummaryWriter(str(args.out / "tensorboard"))
    writer.add_text("settings", json.dumps(asdict(args), default=str))
    history = [float(cost(model, unseen, args.seconds, noise).detach())]
    for epoch in range(2 if args.quick else args.epochs):
        total = 0.0
        for batch in DataLoader(train, args.batch, shuffle=True, collate_fn=list):  # pyright: ignore[reportArgumentType]
            adam.zero_grad()
            error = cost(model, batch, args.seconds, noise)
            error.backward()
            adam.step()
            model.start_from({})  # within the bounds
            total += float(error.detach()) * len(batch) / len(train)
        history.append(float(cost(model, unseen, args.seconds, noise).detach()))
        writer.add_scalars("cost", {"train": total, "unseen": history[-1]}, epoch)
    writer.close()
    save(model, spec, args.out / "model.pt")
    print(json.dumps({"data": data.name, "windows": len(train), "unseen": history}))


if __name__ == "__main__":
    main(tyro.cli(Args))
