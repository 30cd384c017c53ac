"""What is a network worth where physics ends? Physics, with effects, with a network as well, and a network alone.

All are fitted on the same identify flights, cut into the same segments; networks are trained on equations first and
over trajectories second. The network alone has the rigid body's equations and trims and nothing else, no derivative and
no rotor; as many weights as the others have parameters, a wide bound, and the better of two priors by the validate
flights. Where the data set is not there, an aircraft of our own flies with a cause that no effect of the library has.

Expected: beside physics a network lowers the error of unseen flights where something without a name acts; alone it
needs more flights than there are.
"""

from __future__ import annotations

import json
import os
import random
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec
import torch
import tyro
from hidden.drawn_aircraft import draw, fly_drawn, groups_of
from recorded.tables import markdown, number, write_between
from rich.console import Console
from torch.utils.tensorboard import SummaryWriter

import rotorid_torch as rotorid
from rotorid_torch.core.names import FLAPPING, FORCES, MOMENTS, RATES
from rotorid_torch.data.one_rate import at_one_rate
from rotorid_torch.effects.families.neural import TRUST, NeuralForces
from rotorid_torch.effects.registry import register
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.learning.trajectories import learn, memory, regressed
from rotorid_torch.model.nominal import build
from rotorid_torch.run.fit_record import Judged, judge
from rotorid_torch.trace.clean_aircraft import Request, clean_draws
from rotorid_torch.trace.evidence.critical_values import Draws, Null
from rotorid_torch.trace.evidence.family import Family
from rotorid_torch.trace.evidence.fits import Fitted, Flights, refit
from rotorid_torch.trace.evidence.residual import left_over
from rotorid_torch.trace.loop import trace

ROOT = Path(__file__).parents[2]
OUTSIDE = "outside.product"
LISTS = ("identify", "validate", "acid")


@register
class NetworkAlone(NeuralForces):
    """The same network for all forces and moments instead of what is left of them: twice as many hidden units.

    Source: Rackauckas et al., arXiv:2001.04385 (universal differential equations).
    """

    id = "neural.alone"
    hidden, share = 12, 6.0


@dataclass
class Args:
    """Which data set, and how long it may take."""

    data: Path = Path(os.environ.get("ROTORID_SHARED", str(ROOT.parent / "shared"))) / "flightdata" / "uh60-x3"
    """A data set with something in it that has no name; our own aircraft where it is not there."""
    quick: bool = False
    """Physics and networks alone, no effect is looked for; one prior."""
    chance: bool = False
    """Critical values of the search from residuals turned in time, without clean aircraft that are flown for them."""
    report: bool = False
    """Run nothing; turn what is in `out` into the table."""
    page: Path = ROOT / "docs" / "closed-loop.md"
    """Page that holds the table, between its markers."""
    seed: int = 0
    out: Path = Path("runs/networks")
    """Result (scores.json) and TensorBoard records."""


def dataset(args: Args) -> rotorid.Dataset:
    """The data set, or flights of our own aircraft with a cause outside the library."""
    if (args.data / "dataset.toml").exists():
        return rotorid.load(args.data)
    flown = fly_drawn(draw(0, args.seed, args.out), (OUTSIDE,), 1.0, groups_of((OUTSIDE,)), args.seed, args.out)
    return rotorid.load(flown.write(args.out / "flights"))


def alone(spec: ModelSpec, trust: float) -> ModelSpec:
    """A rigid body with trims and a network: one derivative is left in each row, held at zero."""
    return msgspec.structs.replace(
        spec,
        outputs=tuple(c for c in spec.outputs if c not in FLAPPING),
        patterns=dict.fromkeys((*FORCES, *MOMENTS), RATES[:1]),
        free={f"forces.{row}.{RATES[0]}": False for row in (*FORCES, *MOMENTS)},
        flapping="none",
        flapping_doubtful=False,
        inflow=False,
        cyclic_inflow=False,
        rotor=None,
        effects=(NetworkAlone.id,),
        values={},
        sizes={**spec.sizes, TRUST: trust},
    )


def network_alone(spec: ModelSpec, flights: Flights, trust: float, seed: int) -> Fitted:
    """The rigid body's network: on equations first, over trajectories second."""
    bare = alone(spec, trust)
    model = build(bare)
    over = left_over(model, flights.dataset, flights.reconstruction, flights.dataset.identify)
    return refit(bare, flights, regressed(model, over, seed, linear=True))


def models(args: Args, data: rotorid.Dataset, say: Console) -> Iterator[tuple[str, Fitted]]:
    """Each kind of model with what it is called, fitted."""
    base = rotorid.identify(data, seed=args.seed)
    uniform, held, start = at_one_rate(data), base.regressions.held, base.model.named_values
    flights = Flights(uniform, base.reconstruction)
    null = refit(base.spec, flights, start, held)
    yield "physics", null
    if not args.quick:

        def drawn(null: Null, effects: Sequence[str], observed: Family) -> Draws | str:
            if args.chance:
                return "none wanted"
            return clean_draws(Request(uniform, null, effects, args.seed, say.print), observed)

        final = trace(Null(base.spec, start, held), flights, drawn, say.print, args.seed).final
        null = refit(final.spec, flights, final.values, held)
        yield "physics + effects", null
    learnt = learn(null, held, args.seed, say.print)
    say.print(learnt.finding())
    yield "physics + effects + network", refit(learnt.spec, flights, learnt.values, held)
    for trust in (1.0,) if args.quick else (1.0, memory(null) ** -0.5):
        yield "network alone", network_alone(base.spec, flights, trust, args.seed)


def line_of(name: str, fitted: Fitted, judged: Judged, seconds: float) -> dict:
    """Scores of a model on the lists of flights, and those of the noise."""
    noise = {k: [f.J_noise for f in judged.flights.values() if f.list == k and f.J_noise is not None] for k in LISTS}
    return {
        "model": name,
        "free": len(fitted.names),
        "effects": [e for e in fitted.spec.effects if not e.startswith("neural")],
        "J": {k: getattr(judged.scores, k) for k in LISTS},
        "noise": {k: (sum(v * v for v in J) / len(J)) ** 0.5 if J else None for k, J in noise.items()},
        "seconds": round(seconds, 1),
    }


def study(args: Args) -> dict:
    """Fit and score the models; of the networks alone the one stays that describes validate flights better."""
    data, say, began = dataset(args), Console(stderr=True), time.perf_counter()
    writer = SummaryWriter(str(args.out / "tensorboard"))
    writer.add_text("settings", json.dumps(asdict(args), default=str))
    best: dict[str, dict] = {}
    for name, fitted in models(args, data, say):
        line = line_of(name, fitted, judge(fitted.model, data), time.perf_counter() - began)
        began = time.perf_counter()
        say.print(line)
        writer.add_scalars(f"J/{name}", {k: v for k, v in line["J"].items() if v is not None})
        if name not in best or line["J"]["validate"] < best[name]["J"]["validate"]:
            best[name] = line
    writer.close()
    return {"data": data.name, "models": list(best.values())}


def table(result: dict) -> str:
    """One row for each model: J of each list, and without the noise."""
    rows = []
    for line in result["models"]:
        cells = [(line["J"][k], line["noise"][k]) for k in LISTS]
        numbers = [text for j, n in cells for text in (number(j), number(_removed(j, n)))]
        rows.append((line["model"], str(line["free"]), ", ".join(line["effects"]), *numbers, f"{line['seconds']:.0f}"))
    head = ("identify", "less noise", "validate", "less noise", "acid", "less noise")
    said = f"Data set `{result['data']}`. J of free runs, and sqrt(J² - J_noise²) beside it.\n\n"
    return said + markdown(("model", "free parameters", "effects", *head, "s"), rows)


def _removed(j: float | None, noise: float | None) -> float | None:
    return None if j is None or noise is None else max(j * j - noise * noise, 0.0) ** 0.5


def main(args: Args) -> None:
    """Run the comparison or write the table, and end with one JSON line."""
    random.seed(args.seed)
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "scores.json"
    if not args.report:
        file.write_text(json.dumps(study(args)), encoding="utf-8")
    result = json.loads(file.read_text(encoding="utf-8")) if file.exists() else None
    if args.report:
        write_between(args.page, "hybrid", table(result) if result else "No runs yet.")
    print(json.dumps(result))


if __name__ == "__main__":
    main(tyro.cli(Args))
