"""Physics and a network trained together on windows of flights: a script to copy and to change.

The model of `identify` gets a network that sees velocities, rates and controls and adds to forces and moments. Adam
moves its weights on free runs of two seconds, and the physics beside it more slowly. Expected: free runs of flights
that were not trained on come nearer to the measured ones. On the UH-60 in hover an epoch takes a second of one core.
"""

from __future__ import annotations

import json
import os
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
from rotorid_torch.model.save import save


@dataclass
class Args:
    """Which flights (without the folder: short ones of the built-in aircraft), and how long to train."""

    data: Path = Path(os.environ.get("ROTORID_SHARED", "../shared")) / "flightdata" / "uh60-hover"
    out: Path = Path("runs/hybrid")
    epochs: int = 20
    seconds: float = 2.0  # of a window
    batch: int = 32
    rate: float = 3e-3  # of the weights; the physics moves by a hundredth of it, in shares of each parameter's size
    seed: int = 0
    quick: bool = False


@register
class NetworkForces(Effect):
    """Forces (m/s2) and moments (rad/s2) by a network, zero before it is trained, bounded by the rms of each row."""

    id, stage, role, weight_sd = "hybrid.network", Stage.FORCES, Role.LEARNT, 0.5
    reference: Tensor
    size: Tensor
    bound: Tensor

    def __init__(self, spec: ModelSpec) -> None:
        super().__init__()
        self.inputs = tuple(n for n in ("u", "v", "w", "p", "q", "r", *spec.controls) if n in spec.sizes)
        self.net = nn.Sequential(nn.Linear(len(self.inputs), 32), nn.Tanh(), nn.Linear(32, 6))
        for tensor in self.net[2].parameters():
            nn.init.zeros_(tensor)
        self.register_buffer("reference", torch.tensor([spec.reference.get(n, 0.0) for n in self.inputs]))
        self.register_buffer("size", torch.tensor([max(spec.sizes[n], 1e-6) for n in self.inputs]))
        self.register_buffer("bound", torch.tensor([spec.sizes.get(f"row.{row}", 1.0) for row in "XYZLMN"]))

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> NetworkForces:
        """With inputs and outputs scaled as the flights are."""
        return cls(spec)

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds what the network says."""
        out = self.bound * torch.tanh(self.net((frame.stack(self.inputs) - self.reference) / self.size))
        return frame.add(force=out[..., :3], moment=out[..., 3:]), x


def main(args: Args) -> None:
    """Identify the physics, train the network beside it, save both; ends with one JSON line."""
    torch.manual_seed(args.seed)
    here = args.data.exists() and not args.quick
    data = rotorid.load(args.data) if here else rotorid.fly(None, seed=args.seed, seconds=6.0).dataset()
    run = rotorid.identify(data, seed=args.seed)
    model = run.with_effects(NetworkForces.id)
    noise = torch.tensor([data.noise(channel) for channel in model.body.outputs])

    def windows(names: tuple[str, ...], every: float) -> list[tuple[rotorid.Flight, float]]:
        ends = ((data.flights[name], float(data.flights[name].time[-1]) - args.seconds) for name in names)
        return [(flight, every * k) for flight, end in ends for k in range(int(end / every) + 1)]

    def cost(batch: list[tuple[rotorid.Flight, float]]) -> Tensor:
        flights, starts = zip(*batch, strict=True)
        return (model.free_run(flights, starts, args.seconds).residual / noise).square().mean()

    steps = {p: args.rate if n.startswith(NetworkForces.id) else 1e-2 * args.rate * float(p.detach().abs())
             for n, p in model.named_parameters()}  # fmt: skip
    adam = torch.optim.Adam([{"params": [p], "lr": step} for p, step in steps.items()])
    train, unseen = windows(data.identify, 0.25), windows(data.validate, 1.0)
    writer, history = SummaryWriter(str(args.out / "tensorboard")), [float(cost(unseen).detach())]
    writer.add_text("settings", json.dumps(asdict(args), default=str))
    for epoch in range(2 if args.quick else args.epochs):
        for batch in DataLoader(train, args.batch, shuffle=True, collate_fn=list):  # pyright: ignore[reportArgumentType]
            adam.zero_grad()
            error = cost(batch)
            error.backward()
            adam.step()
            model.start_from({})  # within the bounds
            writer.add_scalar("cost/batch", float(error.detach()), epoch)
        history.append(float(cost(unseen).detach()))
        writer.add_scalar("cost/unseen", history[-1], epoch)
    writer.close()
    save(model, run.spec.with_effects(NetworkForces.id), args.out / "model.pt")
    print(json.dumps({"data": data.name, "windows": len(train), "unseen": history}))


if __name__ == "__main__":
    main(tyro.cli(Args))
