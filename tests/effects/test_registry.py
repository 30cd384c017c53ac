"""The registry: own effects enter by their id, and what does not exist is told."""

from __future__ import annotations

import msgspec
import pytest
import torch

from rotorid_torch.effects.base import Effect, Frame, Stage
from rotorid_torch.effects.examples import HELICOPTER
from rotorid_torch.effects.registry import EFFECTS, make, obstacle, register, registered
from rotorid_torch.errors import InputError
from rotorid_torch.model.nominal import build
from tests.effects.own_effects import OwnDrag
from tests.known_models import body_spec


def test_the_library_s_own_are_there():
    assert "control.delay" in registered()
    assert all(name == effect.id for name, effect in registered().items())


def test_an_unknown_effect_is_told_with_those_that_exist():
    with pytest.raises(InputError, match=r"control\.dely.*no such effect.*control\.delay"):
        make("control.dely", body_spec())


def test_an_own_effect_is_made_by_its_id(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("rotorid_torch.effects.registry.EFFECTS", dict(EFFECTS))
    assert register(OwnDrag) is OwnDrag
    assert isinstance(make("own.drag", body_spec()), OwnDrag)


def test_an_effect_must_have_an_id_of_its_own(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("rotorid_torch.effects.registry.EFFECTS", dict(registered()))
    with pytest.raises(ValueError, match="has no id"):
        register(type("Nameless", (Effect,), {}))
    with pytest.raises(ValueError, match=r"control\.delay.*ControlDelay"):
        register(type("Twin", (Effect,), {"id": "control.delay"}))
    register(registered()["control.delay"])  # the same again, as when its module is loaded again


def test_a_model_holds_every_effect_once():
    with pytest.raises(ValueError, match=r"of one id: \['control\.delay'\]"):
        build(body_spec(effects=("control.delay", "control.delay")))


def test_an_effect_does_nothing_unless_it_says_so():
    frame, x = Frame({"u": torch.ones(2)}), torch.zeros(2, 0)
    idle = Effect()
    after, rates = idle(frame, x, None)
    assert after is frame
    assert rates is x
    controls = torch.ones(5, 2)
    assert idle.tape(controls, ("lon", "lat"), 0.02, None) is controls
    assert Effect.stage is Stage.FORCES


def test_a_frame_adds_and_never_changes():
    frame = Frame({"u": torch.ones(2)})
    more = frame.add(force=torch.ones(2, 3)).add(force=torch.ones(2, 3), moment=torch.ones(2, 3))
    assert frame.force is None
    assert more.force is not None
    assert more.force.tolist() == [[2.0] * 3] * 2
    named = frame.with_signals(v=torch.zeros(2), u=torch.zeros(1))
    assert named.stack(("u", "v")).shape == (2, 2)
    assert "v" not in frame.signals


def test_what_the_nominal_model_has_is_refused_beside_it():
    spec = msgspec.structs.replace(HELICOPTER, inflow=True)
    for effect in ("rotor.inflow", "forces.translational_lift"):
        with pytest.raises(InputError, match="the nominal model has it already, as its part 'inflow'"):
            make(effect, spec)
        assert obstacle(effect, HELICOPTER) is None
