"""Selection among a multirotor's effects: what acts joins, what chance explains does not, rivals are a group."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
import torch
from torch import Tensor

from rotorid_torch.core.parameters import Parameter, ParameterSet
from rotorid_torch.effects.examples import HELICOPTER, MULTIROTOR
from rotorid_torch.effects.registry import registered
from rotorid_torch.effects.spec import ModelSpec, MotorSpec
from rotorid_torch.trace import multirotor
from rotorid_torch.trace.multirotor import Identified, believed, trace_rotors
from rotorid_torch.trace.terms.eligible import candidates
from rotorid_torch.trace.terms.finding import Finding

FLIGHTS = {"one": 1, "two": 2, "three": 3, "four": 4}
SPEC = ModelSpec(
    states=("p",),
    controls=("motor1",),
    outputs=("p",),
    reference={},
    sizes={},
    ranges={},
    patterns={},
    control_units={},
)
DELAY, LAG, INERTIA = "control.delay", "propulsion.motor_lag", "propulsion.rotor_inertia"
VOLTAGE = "propulsion.voltage"
SAMPLES, DT = 4000, 0.01


def traced(
    monkeypatch: pytest.MonkeyPatch,
    explained: Mapping[str, float],
    errors: float = 0.001,
    together: float | None = None,
    known: tuple[str, ...] = (DELAY, LAG, INERTIA),
    told: Sequence[Finding] = (),
    motors: bool = False,
    validate: tuple[str, ...] = ("three", "four"),
    by_set: Mapping[tuple[str, ...], float] | None = None,
) -> Any:
    """A search in which every effect takes its share off an error that all flights have; `together` all of them."""
    monkeypatch.setattr(multirotor, "candidates", lambda spec: (list(known), list(told)))
    monkeypatch.setattr(multirotor, "compared", lambda model, flight: {"pdot": model.pair(flight)})
    facts = {name: SimpleNamespace(dt=DT) for name in FLIGHTS}
    lists: dict[str, Any] = {"identify": ("one", "two"), "validate": validate, "unseen": validate or ("one", "two")}
    data: Any = SimpleNamespace(**lists, flights=FLIGHTS, facts=facts)

    def fit(spec: ModelSpec) -> Identified:
        names = [f"{e}.size" for e in spec.effects]
        parameters = [Parameter(n, 0.0, "1", (0.0, 10.0)) for n in names]
        left = max((explained.get(e, 0.0) for e in spec.effects), default=0.0)
        if together is not None and set(explained) <= set(spec.effects):
            left = together
        if by_set is not None:
            left = max((v for es, v in by_set.items() if set(es) <= set(spec.effects)), default=0.0)

        def pair(flight: int) -> tuple[Tensor, Tensor]:
            noise = torch.randn(SAMPLES, generator=torch.Generator().manual_seed(flight), dtype=torch.float64)
            time = DT * torch.arange(SAMPLES, dtype=torch.float64)
            missing = torch.sin(2.0 * math.pi * 0.7 * time + flight)
            return missing + 0.3 * noise, left * missing

        model: Any = SimpleNamespace(
            parameter_set=ParameterSet(tuple(parameters)),
            named_values=dict.fromkeys(names, 0.05),
            pair=pair,
        )
        return Identified(spec, model, dict.fromkeys(names, errors))

    spec = msgspec.structs.replace(SPEC, motors=(MotorSpec(position=(0.0, 0.0, 0.0), spin=1.0),)) if motors else SPEC
    return trace_rotors(spec, data, fit)


def verdicts(tracing: Any) -> dict[str, str]:
    return {f.id: f.verdict for f in tracing.findings}


def test_what_acts_joins_and_what_explains_nothing_does_not(monkeypatch: pytest.MonkeyPatch):
    tracing = traced(monkeypatch, {LAG: 1.0})
    assert tracing.accepted == (LAG,)
    assert tracing.final.spec == msgspec.structs.replace(SPEC, effects=(LAG,))
    assert verdicts(tracing) == {LAG: "accepted", DELAY: "below floor", INERTIA: "below floor"}


def test_of_two_the_better_one_joins(monkeypatch: pytest.MonkeyPatch):
    assert verdicts(traced(monkeypatch, {LAG: 1.0, DELAY: 0.5})) == {
        LAG: "accepted",
        DELAY: "below floor",
        INERTIA: "below floor",
    }


def test_two_that_unseen_flights_do_not_tell_apart_are_a_group(monkeypatch: pytest.MonkeyPatch):
    tracing = traced(monkeypatch, {LAG: 1.0, DELAY: 1.0})
    assert len(tracing.accepted) == 1
    assert verdicts(tracing) == {LAG: "indistinguishable", DELAY: "indistinguishable", INERTIA: "below floor"}


def test_nothing_joins_where_nothing_is_explained_or_its_size_is_not_known(monkeypatch: pytest.MonkeyPatch):
    assert traced(monkeypatch, {}).accepted == ()
    assert traced(monkeypatch, {LAG: 1.0}, errors=0.1).accepted == ()


def test_two_that_explain_a_part_each_both_stay(monkeypatch: pytest.MonkeyPatch):
    tracing = traced(monkeypatch, {LAG: 0.6, DELAY: 0.5}, together=0.97)
    assert tracing.accepted == (LAG, DELAY)
    assert verdicts(tracing) == {LAG: "accepted", DELAY: "accepted", INERTIA: "below floor"}


def test_flights_that_stand_in_for_unseen_ones_are_told(monkeypatch: pytest.MonkeyPatch):
    assert len(traced(monkeypatch, {LAG: 1.0}).notes) == 1
    alone = traced(monkeypatch, {LAG: 1.0}, validate=())
    assert alone.accepted == (LAG,)
    assert alone.notes[1].startswith("no validate flights: ")


def test_what_makes_no_sense_of_motor_commands_is_never_tried():
    """They pass no linkage and no actuator, have a lag of their own, and answer the rates."""
    testable, settled = candidates(MULTIROTOR)
    told = {f.id: (f.verdict, f.reason) for f in settled}
    for effect in ("control.lag", "control.backlash", "control.rate_limit", "forces.quadratic_damping"):
        assert effect not in testable
        assert told[effect][0] == "not testable"
        assert "commands" in told[effect][1]
    assert {DELAY, LAG} <= set(testable)
    assert {"control.lag", "control.backlash"} <= set(candidates(HELICOPTER)[0])


def test_rotor_inertia_comes_with_the_lag_where_the_two_explain_more(monkeypatch: pytest.MonkeyPatch):
    tracing = traced(monkeypatch, {LAG: 0.6, INERTIA: 0.0}, together=0.97)
    assert tracing.accepted == (LAG, INERTIA)
    assert verdicts(tracing) == {LAG: "accepted", DELAY: "below floor", INERTIA: "accepted"}
    (inertia,) = (f for f in tracing.findings if f.id == INERTIA)
    assert inertia.gain > 0.1 > inertia.floor  # beside the lag; alone it gains nothing


@pytest.mark.parametrize("testable", [True, False])
def test_a_centre_of_gravity_that_balance_shows_is_told_with_or_without_a_declared_mass(
    testable: bool, monkeypatch: pytest.MonkeyPatch
):
    shown = Finding("mass.cg", "undeclared", "indistinguishable", "it lies there", values={"mass.cg.x": (0.01, 0.001)})
    without = [Finding("mass.cg", "undeclared", "not testable", "the mass and the inertia are not declared")]
    monkeypatch.setattr(multirotor, "out_of_balance", lambda *given: (shown, None))
    known = (LAG, "mass.cg") if testable else (LAG,)
    tracing = traced(monkeypatch, {LAG: 1.0}, known=known, told=[] if testable else without, motors=True)
    assert [f for f in tracing.findings if f.id == "mass.cg"] == [shown]


def test_turns_count_only_where_some_model_gives_a_control_power_that_can_be():
    spec: Any = SimpleNamespace(mass=1.0, inertia=((1, 0, 0), (0, 1, 0), (0, 0, 1)), motors=(), found_places=None)

    def model(L: float, M: float) -> Any:
        return SimpleNamespace(spec=spec, values={"rotors.power.L": L, "rotors.power.M": M, "rotors.power.N": 1.0})

    assert believed([model(0.1, 0.2), model(0.5, 0.2)]) == ("ax", "ay", "az", "pdot", "rdot")
    assert believed([model(4.0, 0.9)]) == ("ax", "ay", "az", "qdot", "rdot")
    undeclared: Any = SimpleNamespace(mass=None, inertia=None, motors=(), found_places=None)
    free: Any = SimpleNamespace(spec=undeclared, values={"rotors.power.L": 900.0})
    assert "pdot" in believed([free])


def test_a_rival_that_later_effects_leave_behind_is_no_group(monkeypatch: pytest.MonkeyPatch):
    """Alone lag and delay do the same; beside the voltage that joins next, the lag does more."""
    left = {(LAG,): 0.5, (DELAY,): 0.5, (VOLTAGE,): 0.3, (LAG, VOLTAGE): 0.95, (DELAY, VOLTAGE): 0.6}
    tracing = traced(monkeypatch, {}, known=(DELAY, LAG, VOLTAGE), by_set=left)
    assert set(tracing.accepted) == {LAG, VOLTAGE}
    assert tracing.groups == {}
    alike = {**left, (DELAY, VOLTAGE): 0.95}
    tracing = traced(monkeypatch, {}, known=(DELAY, LAG, VOLTAGE), by_set=alike)
    assert len(tracing.accepted) == 2
    assert len(tracing.groups) == 1


def test_what_explains_something_beside_all_that_joined_is_no_rival(monkeypatch: pytest.MonkeyPatch):
    """Alone lag and voltage do the same; together they do more: both join, and neither stands for the other."""
    left = {(LAG,): 0.5, (VOLTAGE,): 0.5, (LAG, VOLTAGE): 0.95}
    tracing = traced(monkeypatch, {}, known=(LAG, VOLTAGE), by_set=left)
    assert set(tracing.accepted) == {LAG, VOLTAGE}
    assert tracing.groups == {}


def test_a_controller_that_answers_noise_is_no_turbulence():
    told = {f.id: f for f in candidates(MULTIROTOR)[1]}
    assert registered()["environment.turbulence"].untestable(MULTIROTOR)
    assert registered()["environment.turbulence"].untestable(HELICOPTER) is None
    assert "environment.turbulence" not in {e for e in candidates(MULTIROTOR)[0]} | set(told)
