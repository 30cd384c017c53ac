"""The model in C says what the model in torch says: with every effect, and every element of a record's way."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch
from torch import Tensor

from rotorid_torch.effects.base import Effect, Stage, Values
from rotorid_torch.effects.examples import MULTIROTOR, example
from rotorid_torch.effects.registry import EFFECTS, registered
from rotorid_torch.effects.signal_operations import lagged, rate_limited, shifted, with_play
from rotorid_torch.errors import InputError, say_once
from rotorid_torch.exporting.c_source import c_source, identifier
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from tests.effects.own_effects import OWN
from tests.exporting.fly import DT, differs, fly_c, fly_torch, moved
from tests.known_models import helicopter, helicopter_spec, scattered, with_values

AGREE = 1e-9
MEMORY = {"control.delay", "control.lag", "control.rate_limit", "control.backlash"}


def with_typical(effect: type[Effect]) -> Model:
    """A vehicle that has the effect at its typical size."""
    spec = example(effect)
    plain = scattered(build(spec))
    model = build(msgspec.structs.replace(spec, effects=(effect.id,)))
    with_values(model, dict(zip(plain.parameter_set.names, plain.theta.tolist(), strict=True)))
    return with_values(model, {p.name: p.typical for p in model.parameter_set.sizes(effect.id) if p.typical})


AVERAGING = sorted(name for name, effect in registered().items() if effect.averages)


@pytest.mark.parametrize(
    "name", sorted(set(registered()) - MEMORY - {"sensors.delay", "sensors.filter"} - set(AVERAGING))
)
def test_every_effect_is_the_same_in_c(name: str, tmp_path: Path):
    assert differs(with_typical(registered()[name]), tmp_path) < AGREE


@pytest.mark.parametrize("effect", OWN, ids=lambda effect: effect.id)
def test_effects_of_users_are_the_same_in_c(effect: type[Effect], tmp_path: Path, monkeypatch):
    monkeypatch.setitem(EFFECTS, effect.id, effect)
    model = with_typical(effect)
    assert differs(model, tmp_path) < AGREE


def test_an_effect_that_knows_whole_records_alone_is_refused_by_name(monkeypatch):
    class Mean(Effect):
        id, stage = "my.mean", Stage.CONTROL

        def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
            return record - record.mean(-2, keepdim=True)

    monkeypatch.setitem(EFFECTS, Mean.id, Mean)
    with pytest.raises(InputError, match=r"my\.mean: acts on whole records"):
        c_source(build(helicopter_spec("none", effects=(Mean.id,))), "refused", DT)


@pytest.mark.parametrize("flapping", ["none", "algebraic", "first order"])
def test_a_helicopter_with_and_without_a_rotor(flapping, tmp_path: Path):
    assert differs(helicopter(flapping), tmp_path) < AGREE


def test_a_multirotor(tmp_path: Path):
    assert differs(scattered(build(MULTIROTOR)), tmp_path) < AGREE


@pytest.mark.parametrize("name", AVERAGING)
def test_what_counts_by_means_comes_as_it_is(name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture):
    """Means of a steady channel are the channel; a line says that an exported model takes no means."""
    say_once.cache_clear()
    model = with_typical(registered()[name])
    controls = moved(model)
    for channel in registered()[name].averages:
        controls[:, model.body.controls.index(channel)] = 0.9 * model.reference[channel]
    x = model.reference_point[0].tolist()
    c = fly_c(c_source(model, "a model", DT), tmp_path, x, controls, DT)
    assert np.allclose(c, fly_torch(model, x, controls, DT), rtol=AGREE, atol=AGREE)
    for channel, seconds in registered()[name].averages.items():
        line = f"{name}: an exported model takes {channel} as it comes; feed means over {seconds:g} s"
        assert [m.startswith(line) for m in caplog.messages] == [True]


def test_what_averages_one_channel_may_not_look_ahead_in_others(monkeypatch: pytest.MonkeyPatch):
    class Early(Effect):
        id, stage, averages = "my.early", Stage.CONTROL, {"lon": 1.0}

        def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
            return record.roll(-1, -2)

    monkeypatch.setitem(EFFECTS, Early.id, Early)
    with pytest.raises(InputError, match=r"my\.early: acts on whole records"):
        c_source(build(helicopter_spec("none", effects=(Early.id,))), "refused", DT)


def behind(effect: str, values: dict[str, float]) -> Model:
    """A helicopter with one effect at these values."""
    model = build(helicopter_spec("none", effects=(effect,)))
    return with_values(with_values(model, helicopter("none").named_values), values)


def path_of(effect: str, values: dict[str, float], controls: Tensor, folder: Path) -> np.ndarray:
    """States and outputs of a helicopter whose controls pass one effect."""
    model = behind(effect, values)
    return fly_c(c_source(model, "path", DT), folder, model.reference_point[0].tolist(), controls, DT)


def plain_run(controls: Tensor) -> np.ndarray:
    """The same helicopter in torch, under controls that have passed already."""
    model = helicopter("none")
    return fly_torch(model, model.reference_point[0].tolist(), controls, DT)


@pytest.mark.parametrize("delay", [0.0, DT, 1.3 * DT, 0.0731, 0.2])
def test_a_delay_is_that_of_whole_records(delay: float, tmp_path: Path):
    controls = moved(helicopter("none"))
    passed = shifted(controls, torch.full((4,), delay, dtype=torch.float64), DT)
    found = path_of("control.delay", {"control.delay.common": delay}, controls, tmp_path)
    assert np.allclose(found, plain_run(passed), rtol=0.0, atol=AGREE)


def test_a_delay_below_one_sample_looks_no_further_than_the_present(tmp_path: Path):
    controls = moved(helicopter("none"))
    passed = shifted(controls, torch.full((4,), 0.4 * DT, dtype=torch.float64), DT)
    found = path_of("control.delay", {"control.delay.common": 0.4 * DT}, controls, tmp_path)
    assert np.allclose(found, plain_run(passed), rtol=0.0, atol=1e-3)


@pytest.mark.parametrize(
    ("effect", "parameter", "size", "passed"),
    [
        ("control.lag", "common", 0.07, lambda u, p: lagged(u, p, DT)),
        ("control.lag", "common", 0.0, lambda u, p: u),
        ("control.rate_limit", "inverse", 20.0, lambda u, p: rate_limited(u, p, DT)),
        ("control.backlash", "width", 0.01, lambda u, p: with_play(u, p)),
    ],
)
def test_an_element_with_memory_is_that_of_whole_records(effect, parameter, size, passed, tmp_path: Path):
    controls = moved(helicopter("none"))
    late = passed(controls, torch.full((4,), size, dtype=torch.float64))
    found = path_of(effect, {f"{effect}.{parameter}": size}, controls, tmp_path)
    assert np.allclose(found, plain_run(late), rtol=0.0, atol=AGREE)


def test_a_late_sensor_is_late_and_an_early_one_refused(tmp_path: Path):
    model = behind("sensors.delay", {"sensors.delay.rates": 0.05})
    assert differs(model, tmp_path) < AGREE
    with_values(model, {"sensors.delay.rates": -0.05})
    with pytest.raises(InputError, match=r"p comes 0.05 s before it is recorded"):
        c_source(model, "early", DT)


def test_a_filter_of_first_order_filters_and_more_is_refused(tmp_path: Path):
    model = behind("sensors.filter", {"sensors.filter.rates": 0.05})
    assert differs(model, tmp_path) < AGREE
    with_values(model, {"sensors.filter.rates_period": 0.05})
    with pytest.raises(InputError, match="first order alone"):
        c_source(model, "second order", DT)


def test_controls_that_are_recorded_late_are_refused():
    model = behind("sensors.delay", {"sensors.delay.controls": 0.05})
    with pytest.raises(InputError, match="looks ahead"):
        c_source(model, "ahead", DT)


def test_the_same_model_is_the_same_text():
    model = helicopter()
    assert c_source(model, "uh60 60 kt", DT) == c_source(model, "uh60 60 kt", DT)


@pytest.mark.parametrize(
    ("title", "name"), [("UH-60 60 kt", "uh_60_60_kt"), ("67g", "model_67g"), ("for", "model_for"), ("±", "model")]
)
def test_titles_become_names_of_c(title: str, name: str):
    assert identifier(title) == name
