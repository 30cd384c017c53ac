"""A user's own physics, about 20 lines, through the same steps as the library's: flown, identified with and without it.

The vehicle is a damped helicopter in hover whose fin stalls; the effect below is not in the library and is registered
here. With --close-loop the package is left to find it by itself.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

import msgspec
import numpy as np
import torch
import tyro
from torch import Tensor

import rotorid_torch as rotorid
from rotorid_torch.core.integrate import simulate
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.rigid import vec
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values
from rotorid_torch.effects.examples import HELICOPTER
from rotorid_torch.effects.registry import register
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.model.nominal import build

DT = 0.02
STALL = 1.5
NOISE = {"u": 0.02, "v": 0.02, "w": 0.02, "p": 0.002, "q": 0.002, "r": 0.002, "phi": 0.001, "theta": 0.001}
DERIVATIVES = {
    "X.u": -0.05, "X.q": 0.4, "X.lon": -6.0, "Y.v": -0.1, "Y.p": -0.4, "Y.lat": 6.0, "Z.w": -0.5, "Z.col": -90.0,
    "L.v": -0.03, "L.p": -3.0, "L.q": -0.6, "L.lat": 30.0, "M.u": 0.01, "M.p": 0.2, "M.q": -2.0, "M.lon": 15.0,
    "N.v": 0.02, "N.r": -0.8, "N.col": 4.0, "N.ped": 12.0,
}  # fmt: skip


@register
class StallingFin(Effect):
    """Fin that stalls: its yawing moment grows with the side speed, and falls beyond the stall.

    N += k vt/(1 + (vt/v_stall)^2), vt = v - arm r.

    Source: the user's own.
    """

    id, stage, role = "my.fin", Stage.FORCES, Role.UNDECLARED
    ARM = 9.0

    def __init__(self) -> None:
        super().__init__(
            (
                Parameter("k", 0.0, "rad/(s m)", (-0.5, 0.5), doc="yaw by side speed at the fin"),
                Parameter("stall", 2.0, "m/s", (0.3, 10.0), 1.0, doc="side speed at which the fin stalls"),
            )
        )

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the yaw."""
        side = frame.signals["v"] - self.ARM * frame.signals["r"]
        yaw = p["k"] * side / (1.0 + (side / p["stall"]) ** 2)
        zero = torch.zeros_like(yaw)
        return frame.add(moment=vec(zero, zero, yaw)), x


def flown(fin: float, seconds: float, seed: int) -> rotorid.Dataset:
    """Flights of the vehicle with a fin of this strength: doublets of every control in turn, two sizes."""
    rng, model = np.random.default_rng(seed), build(_spec(("my.fin",)))
    values = {f"forces.{n}": v for n, v in DERIVATIVES.items()} | {"my.fin.k": fin, "my.fin.stall": STALL}
    with torch.no_grad():
        for name, value in values.items():
            model.theta[model.parameter_set.index(name)] = value
    time, flights = DT * np.arange(round(seconds / DT)), {}
    for name, size in [(c, s) for s in (0.03, 0.05) for c in model.body.controls]:
        moves = np.zeros((len(time), 4))
        for k, c in enumerate(model.body.controls):
            edge, scale = (1.0, size) if c == name else (3.0 + k, 0.3 * size)
            moves[:, k] = scale * ((time > edge) & (time < edge + 1)) - scale * ((time > edge + 1) & (time < edge + 2))
        u = torch.tensor(moves)
        with torch.no_grad():
            x = simulate(model, torch.zeros(len(model.layout), dtype=torch.float64), u, DT)
            clean = dict(zip(model.body.outputs, model.output(x, u).numpy().T, strict=True))
        flights[f"{name}_{size}"] = {"time": time, **dict(zip(model.body.controls, moves.T, strict=True))} | {
            c: clean[c] + sd * rng.standard_normal(len(time)) for c, sd in NOISE.items()
        }
    names = list(flights)
    return rotorid.Dataset.from_arrays(
        flights,
        identify=[*names[:4], names[4], names[6]],
        validate=[names[5], names[7]],
        controls={c: {"unit": "rad", "noise": 1e-5} for c in model.body.controls},
        channels={c: {"noise": sd, "bias": "none"} for c, sd in NOISE.items()},
    )


def _spec(effects: tuple[str, ...]) -> ModelSpec:
    """The example helicopter, rigid, in hover."""
    columns = {row: tuple(c for c in HELICOPTER.patterns["X"] if c not in ("a0", "a1", "b1")) for row in "XYZLMN"}
    return msgspec.structs.replace(
        HELICOPTER, flapping="none", rotor=None, hub=None, outputs=tuple(NOISE), patterns=columns, effects=effects
    )


@dataclass
class Args:
    """Flights, and whether the package finds the effect by itself."""

    quick: bool = False
    seed: int = 0
    close_loop: bool = False


def main(args: Args) -> None:
    """Identify without and with the effect; ends with one JSON line of scores, sizes and verdicts."""
    torch.set_num_threads(1)
    data = flown(0.3, 9.0 if args.quick else 15.0, args.seed)
    without, with_fin = rotorid.identify(data), rotorid.identify(data, effects=["my.fin"])
    result: dict[str, object] = {
        "validate": {"without": without.scores["validate"], "with": with_fin.scores["validate"]},
        "found": {p.name: [p.value, p.se] for p in with_fin.parameters if p.name.startswith("my.fin")},
        "earned": {e.id: e.verdict for e in with_fin.record.effects},
        "true": {"my.fin.k": 0.3, "my.fin.stall": STALL},
    }
    if args.close_loop:
        verdict = rotorid.close_loop(data).verdict
        result["verdict"] = verdict.sentence if verdict is not None else ""
    print(json.dumps(result))


if __name__ == "__main__":
    main(tyro.cli(Args))
