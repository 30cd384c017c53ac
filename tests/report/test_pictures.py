"""The picture on the first screen shows what was discovered, and the control that the flight is about."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import torch

from rotorid_torch.report import records
from rotorid_torch.report.overlay import Overlay
from rotorid_torch.report.page.document import Shown, render
from rotorid_torch.report.page.pictures import main_picture
from tests.report.conftest import an_overlay


def in_flight(flight: str, **moved: float) -> Overlay:
    """A flight of which u moves by these factors; the model is off by a tenth of what moves."""
    plain = an_overlay("validate", flight, shift=0.0)
    measured = {c: moved.get(c, 1.0) * z for c, z in plain.measured.items()}
    controls = {c: moved.get(c, 0.0) * torch.sin(2.0 * plain.time) for c in ("col", "ped")}
    model = {c: (0.9 if c in moved else 1.0) * z for c, z in measured.items()}
    return replace(plain, measured=measured, model=model, controls=controls, units={"col": "rad", "ped": "rad"})


def test_a_channel_that_a_flight_hardly_moves_is_not_the_one_that_gains_most():
    """Of u, which a tenth of its usual motion moves here, all is wrong before; of q a quarter of its usual motion."""
    flown = [in_flight("lon", u=10.0, q=1.0), in_flight("ped", u=0.1)]
    before = [
        replace(flown[0], model=dict(flown[0].model) | {"q": 0.6 * flown[0].measured["q"]}),
        replace(flown[1], model=dict(flown[1].model) | {"u": 0.0 * flown[1].measured["u"]}),
    ]
    shown = main_picture(before, flown)
    assert shown is not None
    assert shown.caption.startswith("Pitch rate (q) on lon")


def test_the_control_is_the_one_that_moves_beyond_what_it_usually_does():
    """Pedals move farther on each flight; on this one the collective moves as nowhere else."""
    flown = [in_flight("col", col=0.5, ped=1.0, q=1.0), in_flight("ped", col=0.01, ped=3.0)]
    shown = main_picture([], [replace(o, model=o.measured) if o.flight == "ped" else o for o in flown])
    assert shown is not None
    assert "col, rad" in shown.image
    assert "ped, rad" not in shown.image


def test_of_an_unknown_the_channel_is_shown_on_which_it_acts(report: records.Report):
    unknown = records.UnknownRecord(where="L", band_hz=(0.1, 1.0), goes_with="lat", since_s=None, sentence="In L.")
    shown = main_picture([], [in_flight("a", p=1.0, q=9.0), in_flight("b", p=3.0)], report.fit, unknown)
    assert shown is not None
    assert shown.caption.startswith("Roll rate (p) on b")
    assert "What is missing acts on it" in shown.caption


def test_of_a_name_that_is_shown_which_it_explains(report: records.Report, fit: records.FitRecord):
    effect = records.EffectRecord(id="control.delay", role="undeclared", verdict="accepted", reason="gain above floor")
    verdict = records.VerdictRecord(kind="undeclared", effects=("control.delay",), sentence="Undeclared.")
    loop = records.Report(
        command="close-loop", dataset=report.dataset, seed=0, time_s=report.time_s, peak_memory_mb=1.0,
        before=fit, after=fit, effects=(effect,), verdict=verdict,
    )  # fmt: skip
    flown = in_flight("lon", q=1.0)
    flown = replace(flown, without={e: {"q": 0.5 * flown.measured["q"]} for e in ("control.delay", "forces.drag")})
    first, _, rest = render(loop, Shown([flown], [flown])).partition("<nav")
    said = "what the model leaves over without a delay in the control path"
    assert first.count(f"{said}, and what that explains of it. Top") == 1
    assert said not in rest
    drag = msgspec.structs.replace(effect, id="forces.drag")
    two = msgspec.structs.replace(loop, effects=(effect, drag))
    poor = replace(flown, model=dict(flown.model) | {"q": 0.0 * flown.time})
    first, _, rest = render(two, Shown([flown], [poor])).partition("<nav")
    assert "gains most" in first
    assert said in rest
