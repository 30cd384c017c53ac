"""What the page on networks says runs as it stands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch

import rotorid_torch as rotorid
from rotorid_torch.effects.registry import EFFECTS
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.model.own_effects import extended
from tests.known_models import DERIVATIVES, body_spec, flown, linear_vehicle, manoeuvres, with_values

PAGE = (Path(__file__).parents[3] / "docs" / "own-network.md").read_text(encoding="utf-8")
EFFECT, TRAINING, KEEPING = (part.partition("```")[0] for part in PAGE.split("```python\n")[1:])
TRAINING = "".join(line for line in TRAINING.splitlines(True) if not line.startswith(("data =", "run =")))
"""On flights and a model of our own, in the place of those of the page."""


@dataclass
class Identified:
    """What the page asks of a run."""

    spec: ModelSpec
    model: Model

    def with_effects(self, *effects: str) -> Model:
        return extended(self.model, self.spec, effects)

    def export(self, model: Model, statespace: str, overwrite: bool) -> None:
        assert overwrite
        assert statespace.endswith(".json")
        assert model.effect("my.pitch") is not None


def test_the_page_trains_a_network_on_windows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A pitch damping of half the true one is made up for by the network."""
    lists = {"identify": ["f_lon", "f_lat", "f_col"], "validate": ["f_ped"]}
    data = flown(linear_vehicle(), manoeuvres(6.0, 0.02), 0.02, noise=0.01, lists=lists)
    half = DERIVATIVES | {"M.q": 0.5 * DERIVATIVES["M.q"]}
    spec = body_spec()
    start = with_values(build(spec), {f"forces.{name}": value for name, value in half.items()})
    names: dict[str, Any] = {"rotorid": rotorid, "data": data, "run": Identified(spec, start)}
    torch.manual_seed(0)
    try:
        exec(compile(EFFECT, "own-network.md", "exec"), names)
        exec(compile(TRAINING, "own-network.md", "exec"), names)
        monkeypatch.chdir(tmp_path)
        exec(compile(KEEPING, "own-network.md", "exec"), names)
    finally:
        EFFECTS.pop("my.pitch", None)
    flights = [data.flights[n] for n in data.identify]
    costs = [
        float((m.free_run(flights, [1.0] * len(flights), 2.0).residual.detach() / names["noise"]).square().mean())
        for m in (start, names["model"])
    ]
    assert costs[1] < 0.5 * costs[0]
    moved = {n for n, v in names["model"].named_values.items() if v != start.named_values.get(n)}
    assert moved
    assert all(n.startswith("my.pitch") for n in moved)
