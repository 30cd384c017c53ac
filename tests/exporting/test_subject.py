"""What of a multirotor's model is handed over: no input that nothing reads, and a word on moments that are held."""

from pathlib import Path

import msgspec
import pytest
import torch

from rotorid_torch.effects.examples import MULTIROTOR
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.exporting.subject import Subject
from rotorid_torch.exporting.targets import export
from rotorid_torch.model.nominal import build
from tests.known_models import points


def subject(spec: ModelSpec) -> Subject:
    return Subject(build(spec), spec, "a quadrotor", 0.01, "x")


def test_a_voltage_that_nothing_reads_is_no_input():
    whole = subject(MULTIROTOR)
    whole.model.theta.data += 0.01
    lean = whole.driven()
    assert "voltage" in whole.model.body.controls
    assert lean.model.body.controls == MULTIROTOR.controls
    x, u = points(whole.model, 5, spread=0.01)
    motors = u[:, : len(MULTIROTOR.controls)]
    assert torch.equal(lean.model.rates(lean.model.theta, x, motors), whole.model.rates(whole.model.theta, x, u))


def test_a_voltage_that_an_effect_reads_stays():
    read = subject(msgspec.structs.replace(MULTIROTOR, effects=("propulsion.voltage",)))
    assert read.driven() is read


def test_an_export_warns_of_moments_that_are_held(tmp_path: Path):
    held = msgspec.structs.replace(MULTIROTOR, free={"rotors.power.L": False}, values={"rotors.power.L": 0.0})
    with pytest.warns(UserWarning, match="^L held at zero: flights do not tell"):
        export(subject(held), {"statespace": tmp_path / "held.json"})
    export(subject(MULTIROTOR), {"statespace": tmp_path / "free.json"})
