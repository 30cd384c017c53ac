"""Mistakes in an effect of a user are told in one line with its id before any work; effects without any pass."""

from __future__ import annotations

import importlib
import json
import re
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from rotorid_torch import cli
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.state import State
from rotorid_torch.data import Dataset
from rotorid_torch.effects import registry
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values
from rotorid_torch.effects.examples import HELICOPTER, MULTIROTOR, example
from rotorid_torch.effects.registry import EFFECTS, registered
from rotorid_torch.errors import InputError
from rotorid_torch.model.own_effects import refuse_faulty
from rotorid_torch.run import close_loop, pipeline
from tests.effects.own_effects import OWN
from tests.helpers import small_flight, small_folder

Forward = Callable[[Frame, Tensor, Values], Any]
K = Parameter("k", 0.0, "1", (-1.0, 1.0))


def axis(values: Tensor) -> Tensor:
    """A moment about the first axis."""
    return torch.stack([values, torch.zeros_like(values), torch.zeros_like(values)], dim=-1)


def an_effect(
    forward: Forward = lambda f, x, p: (f.add(moment=axis(p["k"] * f.signals["p"])), x),
    declared: Callable[[], Any] = lambda: (K,),
    states: tuple[State, ...] = (),
    **attributes: Any,
) -> type[Effect]:
    def __init__(self: Effect) -> None:
        Effect.__init__(self, declared(), states)

    methods = {"__init__": __init__, "forward": lambda self, f, x, p: forward(f, x, p)}
    return type("Mine", (Effect,), {"id": "my.effect", **methods, **attributes})


def branch(f: Frame, x: Tensor, p: Values) -> Any:
    return (f.add(moment=axis(p["k"] * f.signals["p"])) if f.signals["p"] > 0 else f), x


def branch_on_size(f: Frame, x: Tensor, p: Values) -> Any:
    return (f.add(moment=axis(p["k"] * f.signals["p"])) if p["k"] > 0 else f), x


def in_place(f: Frame, x: Tensor, p: Values) -> Any:
    f.signals["p"].mul_(1.0 + 1e-3)
    return f, x


def raising(f: Frame, x: Tensor, p: Values) -> Any:
    raise ZeroDivisionError("no fin")


def reading(name: str) -> Forward:
    return lambda f, x, p: (f.add(moment=axis(p["k"] * f.signals[name])), x)


_BARE = Effect()
LATE = (State("late", "rad", "late stick"),)
MISTAKES: dict[str, tuple[type[Effect], str]] = {
    "an unknown signal": (
        an_effect(reading("speed")),
        r"forward: asks for 'speed', which is no signal of this model; expected one of u, v, w",
    ),
    "an unknown parameter": (
        an_effect(lambda f, x, p: (f.add(moment=axis(p["K"] * f.signals["p"])), x)),
        r"forward: ValueError: 'K' is read and not declared; declared are k",
    ),
    "a branch on a signal": (an_effect(branch), r"forward: a number is asked of a tensor.*torch\.where"),
    "a branch on a size": (an_effect(branch_on_size), r"forward: a number is asked of a tensor.*torch\.where"),
    "a branch on all points": (
        an_effect(lambda f, x, p: (f.add(moment=axis(p["k"] * f.signals["p"])) if f.signals["p"].max() < 9 else f, x)),
        r"forward: asks a batch for one number.*torch\.where",
    ),
    "an item": (
        an_effect(lambda f, x, p: (f.add(moment=axis(p["k"].item() * f.signals["p"])), x)),
        r"forward: a number is asked of a tensor.*torch\.where",
    ),
    "a moment without axes": (
        an_effect(lambda f, x, p: (f.add(moment=p["k"] * f.signals["p"]), x)),
        r"moment: has the shape \(5,\); expected \(5, 3\)",
    ),
    "a parameter with a vector": (
        an_effect(lambda f, x, p: (f.add(moment=p["k"] * f.stack(("p", "q", "r"))), x)),
        r'forward: 2 and 5 entries do not go together; expected .* p\["name"\]\[\.\.\., None\]',
    ),
    "a parameter that nothing uses": (
        an_effect(declared=lambda: (K, Parameter("unused", 0.0, "1", (-1.0, 1.0)))),
        r'my\.effect: unused: is declared, and no method of the effect uses it; expected p\["unused"\] in forward',
    ),
    "a mean of all points": (
        an_effect(lambda f, x, p: (f.add(moment=axis(p["k"] * (f.signals["p"] - f.signals["p"].mean()))), x)),
        r"forward: gives a point of a batch other numbers than the same point alone; expected .*dim=-1",
    ),
    "half precision": (
        an_effect(lambda f, x, p: (f.add(moment=axis(p["k"] * f.signals["p"]).half()), x)),
        r"moment: holds numbers of torch\.float16; expected float64",
    ),
    "NumPy": (
        an_effect(lambda f, x, p: (f.add(moment=axis(p["k"] * np.sin(f.signals["p"]))), x)),
        r"forward: uses NumPy, which knows no derivatives; expected torch functions",
    ),
    "random numbers": (
        an_effect(lambda f, x, p: (f.add(moment=axis(p["k"] * torch.randn(5).double())), x)),
        r"forward: draws random numbers",
    ),
    "no physics": (
        an_effect(forward=lambda f, x, p: Effect.forward(_BARE, f, x, p)),
        r"effect my\.effect: k: is declared, and no method of the effect uses it",
    ),
    "no parameters in forward": (
        type("Short", (an_effect(),), {"forward": lambda self, f, x: (f, x)}),
        r"forward: takes \(f, x\); expected forward\(frame, x, p\)",
    ),
    "no call of the base class": (an_effect(__init__=lambda self: None), r"declared: is None; expected a tuple"),
    "the first of the points": (
        an_effect(lambda f, x, p: (f.add(moment=axis(p["k"] * f.stack(("p", "q"))[:, 0])), x)),
        r"more indices than its 1 dimensions; expected tensors \[..., n\]",
    ),
    "a force of one axis": (
        an_effect(lambda f, x, p: (f.add(force=(p["k"] * f.signals["p"])[..., None]), x)),
        r"force: has the shape \(5, 1\); expected \(5, 3\)",
    ),
    "what a frame has not": (
        an_effect(lambda f, x, p: (f.add(moment=f.vector(0.0, p["k"], 0.0)), x)),
        r"forward: AttributeError: 'Frame' object has no attribute 'vector'",
    ),
    "no rates": (an_effect(lambda f, x, p: f), r"forward: returns no pair; expected a Frame and the rates"),
    "rates of none": (
        an_effect(lambda f, x, p: (f, x[..., :0]), states=LATE),
        r"forward: rates are \(5, 0\); expected \[\.\.\., 1\]",
    ),
    "NaN at nothing": (
        an_effect(lambda f, x, p: (f.add(moment=axis(p["k"] / p["k"] * f.signals["p"])), x)),
        r"forward: makes the rate of p infinite or NaN at its declared values",
    ),
    "no slope at nothing": (
        an_effect(lambda f, x, p: (f.add(moment=axis(p["k"].sqrt() * f.signals["p"])), x)),
        r"forward: has no finite derivative by my\.effect\.k",
    ),
    "no null": (
        an_effect(lambda f, x, p: (f.add(moment=axis((p["k"] + 0.1) * f.signals["p"])), x)),
        r"forward: changes the rate of p by .* at its declared values; expected declared values at which",
    ),
    "an error": (an_effect(raising), r"forward: ZeroDivisionError: no fin"),
    "signals changed in place": (an_effect(in_place), r"forward: changes the signals that it is handed in place"),
    "no equilibrium": (
        an_effect(lambda f, x, p: (f.add(moment=axis(p["k"] * x[..., 0])), f.signals["lat"][..., None]), states=LATE),
        r"my\.effect\.late: rests at no value",
    ),
    "reversed bounds": (
        an_effect(declared=lambda: (Parameter("k", 0.0, "1", (1.0, -1.0)),)),
        r"from_spec: k: bounds 1\.0 to -1\.0 are reversed",
    ),
    "equal bounds": (
        an_effect(declared=lambda: (Parameter("k", 0.0, "1", (0.0, 0.0)),)),
        r"k: bounds 0\.0 to 0\.0 leave it no room",
    ),
    "a typical size out of bounds": (
        an_effect(declared=lambda: (Parameter("k", 0.0, "1", (0.0, 1.0), typical=2.0),)),
        r"typical 2\.0 lies outside its bounds",
    ),
    "a parameter twice": (an_effect(declared=lambda: (K, K)), r"parameters: ValueError: declared twice: \['k'\]"),
    "no parameter": (an_effect(declared=lambda: ()), r"parameters: none is declared.*nn\.ModuleList for a list"),
    "no tuple of parameters": (an_effect(declared=lambda: ["k"]), r"declared: is \['k'\]; expected a tuple"),
    "a state twice": (an_effect(states=LATE * 2), r"states: ValueError: states declared twice: \['late'\]"),
    "a word as stage": (an_effect(stage="forces"), r"stage: is 'forces'"),
    "a word as role": (an_effect(role="undeclared"), r"role: is 'undeclared'"),
    "an id without a dot": (an_effect(id="drag"), r"effect drag: id: is no id"),
    "the beginning of an id": (an_effect(id="control.delay.mine"), r"control\.delay"),
    "a record of a force": (
        an_effect(tape=lambda self, record, names, dt, p: record * (1.0 + p["k"])),
        r"tape: is called of controls and sensors alone, and the stage is FORCES; expected Stage\.CONTROL or",
    ),
    "a record of another length": (
        an_effect(stage=Stage.CONTROL, tape=lambda self, record, names, dt, p: record[..., 1:, :]),
        r"tape: returns \(39, 4\); expected a record \(40, 4\)",
    ),
    "a record for one size alone": (
        an_effect(stage=Stage.CONTROL, tape=lambda self, record, names, dt, p: record + p["k"] * torch.zeros(40, 4)),
        r"tape: 2 and 40 entries do not go together",
    ),
    "no answer to what can be tested": (
        an_effect(untestable=classmethod(lambda cls, spec: spec.no_such_field)),
        r"untestable and within: AttributeError",
    ),
}  # fmt: skip


@pytest.fixture(autouse=True)
def library(monkeypatch: pytest.MonkeyPatch) -> None:
    """Effects that a test registers are gone after it."""
    monkeypatch.setattr("rotorid_torch.effects.registry.EFFECTS", dict(registered()))


def install(effect: type[Effect]) -> str:
    registered()[effect.id] = effect
    return effect.id


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told_in_one_line_with_the_effect_s_id(mistake: str):
    effect, said = MISTAKES[mistake]
    with pytest.raises(InputError, match=said) as told:
        refuse_faulty(
            [install(effect), *(["control.delay"] if mistake.startswith("the beginning") else [])], HELICOPTER
        )
    assert "\n" not in str(told.value)
    assert str(told.value).startswith("effect ")


@pytest.mark.parametrize("effect", [*OWN, an_effect()])
@pytest.mark.parametrize("spec", [HELICOPTER, MULTIROTOR])
def test_effects_without_a_mistake_pass(effect: type[Effect], spec: Any):
    if effect is OWN[1] and spec is MULTIROTOR:
        pytest.skip("it reads the lateral stick")
    refuse_faulty([install(effect)], spec)


@pytest.mark.parametrize("name", [n for n, e in sorted(registered().items()) if e.role is not Role.LEARNT])
def test_the_library_s_own_pass(name: str):
    """The rules are none that physics cannot keep."""
    refuse_faulty([name], example(registered()[name]))


@pytest.mark.parametrize("command", ["identify", "close_loop"])
def test_a_signal_that_this_vehicle_lacks_is_told_before_any_work(command: str, monkeypatch: pytest.MonkeyPatch):
    """Flapping is measured on the example vehicle, and not here."""
    monkeypatch.setattr("rotorid_torch.run.pipeline.motion_and_forces", lambda *_: pytest.fail("step 1 was begun"))
    name = install(an_effect(reading("a1")))
    dataset = Dataset.from_arrays({"f": small_flight()}, identify=["f"])
    begin = partial(pipeline.identify, effects=[name]) if command == "identify" else close_loop.close_loop
    with pytest.raises(InputError, match=r"effect my\.effect: forward: asks for 'a1'"):
        begin(dataset)


PAGE = (Path(__file__).parents[2] / "docs" / "own-effect.md").read_text(encoding="utf-8")
EXAMPLE = PAGE.partition("```python\n")[2].partition("```")[0]
"""The effect of the page of the docs."""


@pytest.fixture
def packaged(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Callable[[str], None]]:
    """Installs a module as the page says, by an entry point of a package; what it registers is gone after the test."""
    place = tmp_path / "site"

    def install(source: str) -> None:
        information = place / "my_project-1.0.dist-info"
        information.mkdir(parents=True)
        (place / "my_effects.py").write_text(source, encoding="utf-8")
        (information / "METADATA").write_text("Metadata-Version: 2.1\nName: my-project\nVersion: 1.0\n")
        (information / "entry_points.txt").write_text("[rotorid_torch.effects]\nmy-effects = my_effects\n")
        monkeypatch.syspath_prepend(place)
        importlib.invalidate_caches()
        registry._import.cache_clear()

    yield install
    sys.modules.pop("my_effects", None)
    monkeypatch.undo()
    registry._import.cache_clear()
    registered()


def told_by(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = cli.main([str(a) for a in arguments])
    return code, *capsys.readouterr()


def test_the_effect_of_the_page_is_listed_once_it_is_installed(
    packaged: Callable[[str], None], capsys: pytest.CaptureFixture[str]
):
    packaged(EXAMPLE)
    code, out, _ = told_by(capsys, "effects", "--json")
    assert code == 0
    mine = next(e for e in json.loads(out)["effects"] if e["id"] == "my.drag")
    assert [p["name"] for p in mine["parameters"]] == ["x", "y", "z"]
    refuse_faulty(["my.drag"], HELICOPTER)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            ("from rotorid_torch import Effect", "import no_such_module\nfrom rotorid_torch import Effect"),
            "effects of my-effects: my_effects: cannot be loaded",
        ),
        (('"my.drag"', '"forces.drag"'), "cannot be loaded .*forces.drag.* is taken"),
        (('("u", "v", "w")', '("u", "v", "W")'), "effect my.drag: forward: asks for 'W'"),
        (("(0.0, 0.05)", "(0.05, 0.0)"), r"effect my.drag: from_spec: .*bounds 0\.05 to 0\.0 are reversed"),
    ],
)
@pytest.mark.parametrize("command", [("identify", "--effect", "my.drag"), ("close-loop",)])
def test_the_commands_refuse_a_faulty_package_in_one_line(
    packaged: Callable[[str], None],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    command: tuple[str, ...],
    change: tuple[str, str],
    said: str,
):
    assert change[0] in EXAMPLE
    packaged(EXAMPLE.replace(*change))
    data, out = small_folder(tmp_path / "data"), tmp_path / "run"
    code, _, err = told_by(capsys, command[0], data, "--out", out, *command[1:])
    assert code == 2
    assert re.search(said, err)
    assert err.count("\n") == 1
    assert not out.exists()


def test_nothing_is_left_of_the_trial(monkeypatch: pytest.MonkeyPatch):
    before = np.random.get_state()[1].copy(), torch.random.get_rng_state()  # noqa: NPY002
    refuse_faulty([install(an_effect())], HELICOPTER)
    assert np.array_equal(before[0], np.random.get_state()[1])  # noqa: NPY002
    assert torch.equal(before[1], torch.random.get_rng_state())
    assert set(EFFECTS) >= {"control.delay"}
