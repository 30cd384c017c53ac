"""Thrusts out of balance are told with their cause or their rivals; ordinary rotors and chance are not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from msgspec.structs import replace
from torch import Tensor

from rotorid_torch.data import Dataset
from rotorid_torch.effects.families.propulsion import usual_inflow
from rotorid_torch.effects.momentum import USUAL_TILT
from rotorid_torch.effects.signal_operations import lagged
from rotorid_torch.effects.spec import ModelSpec, MotorSpec
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.balance import (
    LATE_S,
    Balance,
    Standing,
    balances,
    going_with,
    out_of_balance,
    standing,
)

ARM = 0.033
PLACES = ((1, 1, -1), (-1, 1, 1), (-1, -1, -1), (1, -1, 1))
MOTORS = tuple(f"motor{k}" for k in range(1, 5))
SPEC = ModelSpec(
    states=("p", "q", "r"),
    controls=MOTORS,
    outputs=("p", "q", "r", "az"),
    reference=dict.fromkeys(MOTORS, 0.5),
    sizes={},
    ranges={},
    patterns=dict.fromkeys("ZLMN", ()),
    control_units=dict.fromkeys(MOTORS, "norm"),
    motors=tuple(MotorSpec(position=(ARM * x, ARM * y, 0.0), spin=s) for x, y, s in PLACES),
    spins=tuple(float(s) for _, _, s in PLACES),
)
LEVERS = torch.tensor([[ARM * x, ARM * y, s] for x, y, s in PLACES], dtype=torch.float64)
MEANS = 20
UNLIKE, YAW = 0.02, 0.04
"""Standard deviations of clean vehicles: thrust of each rotor, and yaw balance by what else turns the vehicle."""


def clean(seed: int = 0, count: int = 199) -> Tensor:
    """Balance of clean vehicles [count, 3], by the first order of small differences."""
    chance = torch.Generator().manual_seed(seed)
    centres = UNLIKE * torch.randn(count, 4, generator=chance, dtype=torch.float64) @ LEVERS / 4
    yaw = YAW * torch.randn(count, generator=chance, dtype=torch.float64)
    return torch.cat([centres[:, :2], centres[:, 2:] + yaw[:, None]], dim=1)


AHEAD = torch.tensor([0.006, 0.0, 0.0], dtype=torch.float64)


def flight(seed: int, centre: Tensor | None = None, by_speed: float = 0.0, after: float = 0.0) -> Balance:
    chance = torch.Generator().manual_seed(seed)
    speed, other = (torch.randn(MEANS, generator=chance, dtype=torch.float64) for _ in range(2))
    noise = torch.randn(MEANS, 3, generator=chance, dtype=torch.float64) * torch.tensor([1e-4, 1e-4, 3e-3])
    turning = torch.randn(MEANS, 3, generator=chance, dtype=torch.float64)
    made = noise + 1e-4 * turning + (0.0 if centre is None else centre)
    made[:, 0] += by_speed * late(u=speed)["u", after]
    return Balance(made, torch.zeros_like(made), turning, late(u=speed, v=other))


def late(**signals: Tensor) -> dict[tuple[str, float], Tensor]:
    """Signals as they are and late, at one mean a second."""
    taus = torch.tensor(LATE_S, dtype=torch.float64)
    followed = {n: lagged(v[:, None].expand(-1, len(taus)), taus, 1.0) for n, v in signals.items()}
    return {(n, tau): v[:, k] for n, v in followed.items() for k, tau in enumerate(LATE_S)}


def flights(*seeds: int, **what: Any) -> list[Balance]:
    return [flight(seed, **what) for seed in seeds]


def of_weak(rotor: int, less: float) -> Tensor:
    """Thrust centre by the commands of a vehicle that balances with one rotor that gives less than they say."""
    commanded = torch.ones(4, dtype=torch.float64)
    commanded[rotor] /= 1.0 - less
    return commanded @ LEVERS / commanded.sum()


def stood(*seeds: int, **what: Any) -> Standing | None:
    return standing(SPEC, flights(*seeds, **what), flights(*(1000 + seed for seed in seeds), **what), clean())


def test_what_the_mean_of_flights_is_uncertain_by_is_drawn_by_the_seed():
    identify, unseen = (flights(*seeds, centre=AHEAD) for seeds in ((1, 2), (3, 4)))
    usual, same, other = (standing(SPEC, identify, unseen, clean(), seed) for seed in (0, 0, 1))
    assert usual is not None
    assert same is not None
    assert other is not None
    assert usual.errors.equal(same.errors)
    assert not usual.errors.equal(other.errors)


def test_a_pitching_moment_by_speed_holds_on_unseen_flights():
    going = going_with(flights(1, 2, by_speed=3e-4), flights(3, 4, by_speed=3e-4))
    assert [(g.row, g.signal, g.late) for g in going] == [("M", "u", 0.0)]
    assert going[0].remaining < 0.5 * going[0].without
    assert going[0].remaining == pytest.approx(1e-4, rel=0.4)


def test_a_moment_that_follows_late_comes_with_how_late():
    going = going_with(flights(1, 2, by_speed=1e-3, after=2.0), flights(3, 4, by_speed=1e-3, after=2.0))
    assert [(g.row, g.signal, g.late) for g in going] == [("M", "u", 2.0)]
    assert going[0].remaining < 0.5 * going[0].without


def test_what_unseen_flights_do_not_show_is_not_said():
    assert going_with(flights(1, 2, by_speed=3e-4), flights(3, 4)) == []
    assert going_with(flights(1, 2), flights(3, 4)) == []


def test_chance_speaks_on_few_of_many_vehicles():
    going = [going_with(flights(4 * k, 4 * k + 1), flights(4 * k + 2, 4 * k + 3)) for k in range(60)]
    assert sum(bool(one) for one in going) <= 4


def test_slow_wandering_is_no_evidence():
    """Neighbouring means that resemble each other are few values, however many they are."""

    def wandering(seed: int) -> Balance:
        chance = torch.Generator().manual_seed(seed)
        slow = torch.randn(2, MEANS, generator=chance, dtype=torch.float64).cumsum(dim=1)
        zero = torch.zeros(MEANS, dtype=torch.float64)
        turning = torch.randn(MEANS, 3, generator=chance, dtype=torch.float64)
        wander = torch.stack([slow[0], zero, zero], dim=1)
        return Balance(wander, torch.zeros_like(wander), turning, late(u=slow[1]))

    going = [going_with([wandering(2 * k)], [wandering(2 * k + 1)]) for k in range(60)]
    assert sum(bool(one) for one in going) <= 4


@pytest.mark.parametrize("rotor", range(4))
def test_one_weak_rotor_stands_out_from_a_centre_of_gravity_elsewhere(rotor: int):
    for less, open_ in ((0.1, True), (0.5, False)):  # yaw of ordinary rotors hides a tenth of one rotor's
        off = stood(1, 2, 3, centre=of_weak(rotor, less))
        assert off is not None
        assert (off.moved, off.rotor) == (open_, rotor)
        assert abs(off.less - less) < 2.0 * off.less_error < 0.08


def test_of_two_rotors_that_may_be_the_weak_one_none_is_named():
    """Two rotors of one arm turn against each other, and yaw of ordinary vehicles hides which of them gives less."""
    places = tuple((x, y, z, s) for x, y, _ in PLACES for z, s in ((-0.01, 1), (0.01, -1)))
    motors = tuple(MotorSpec(position=(ARM * x, ARM * y, z), spin=s) for x, y, z, s in places)
    spec = replace(SPEC, motors=motors, spins=tuple(float(s) for *_, s in places))
    levers = torch.tensor([[ARM * x, ARM * y, s] for x, y, _, s in places], dtype=torch.float64)
    chance = torch.Generator().manual_seed(3)
    vehicles = UNLIKE * torch.randn(199, 8, generator=chance, dtype=torch.float64) @ levers / 8
    vehicles[:, 2] += YAW * torch.randn(199, generator=chance, dtype=torch.float64)
    off = standing(spec, flights(1, 2, centre=0.2 * levers[2] / 8), flights(3, 4, centre=0.2 * levers[2] / 8), vehicles)
    assert off is not None
    assert (off.moved, off.rotor) == (True, None)


def test_a_rotor_that_gives_more_is_no_weak_rotor_opposite():
    """Its opposite one gives less by the thrust centre; yaw by half of all thrust decides."""
    off = stood(1, 2, 3, centre=of_weak(0, -3.0))
    assert off is not None
    assert off.rotor is None


def test_a_centre_of_gravity_elsewhere_leaves_yaw_alone():
    off = stood(1, 2, 3, centre=AHEAD)
    assert off is not None
    assert (off.moved, off.rotor) == (True, None)
    assert float(off.centre[0]) == pytest.approx(0.006, abs=1e-4)


def test_clean_vehicles_stand_out_as_often_as_the_level_says():
    p = [stood(k, k + 1, centre=centre) for k, centre in enumerate(clean(seed=1, count=300))]
    assert 3 <= sum(off is not None for off in p) <= 27


def test_yaw_alone_is_judged_by_how_clean_vehicles_turn():
    """Twice the standard deviation is ordinary, whatever the rotors' thrusts."""
    assert stood(1, 2, 3, centre=torch.tensor([0.0, 0.0, 2.0 * YAW], dtype=torch.float64)) is None


def test_what_unseen_flights_do_not_bear_out_is_not_said():
    assert standing(SPEC, flights(1, 2, centre=AHEAD), flights(3, 4, centre=-AHEAD), clean()) is None


def verdict(monkeypatch: pytest.MonkeyPatch, push: float = 0.0, **what: Any) -> Any:
    monkeypatch.setattr(
        "rotorid_torch.trace.balance.balances", lambda model, spec, data, names: flights(*names, **what)
    )
    monkeypatch.setattr("rotorid_torch.simulation.drawn.multirotors.undrawable_multirotor", lambda data: None)
    drawn = "rotorid_torch.simulation.drawn.multirotors.clean_balances"
    monkeypatch.setattr(drawn, lambda data, seed, draws: clean().numpy())
    data: Any = SimpleNamespace(identify=(1, 2, 3))
    model: Any = SimpleNamespace(named_values={"rotors.trim.X": push})
    return out_of_balance(model, SPEC, data, [4, 5])  # pyright: ignore[reportArgumentType]


def test_one_rotor_that_gives_less_is_named_with_its_size(monkeypatch: pytest.MonkeyPatch):
    finding, missing = verdict(monkeypatch, centre=of_weak(2, 0.5), by_speed=3e-4)
    assert (finding.id, finding.verdict, finding.group) == ("propulsion.unequal", "accepted", ())
    value, error = finding.values["propulsion.unequal.motor3"]
    assert abs(value - 0.5) < 2.0 * error < 0.08
    assert "as if the rotor of motor3 gave 50 % less" in finding.reason
    assert missing.where == "M"
    assert "M: it goes with u" in missing.sentence


def test_a_rotor_and_a_weight_near_another_are_a_group_where_yaw_leaves_both_open(monkeypatch: pytest.MonkeyPatch):
    finding, missing = verdict(monkeypatch, centre=of_weak(2, 0.1))
    assert missing is None
    assert (finding.id, finding.verdict, finding.group) == ("propulsion.unequal", "indistinguishable", ("mass.cg",))
    assert finding.values["propulsion.unequal.motor3"][0] == pytest.approx(0.1, abs=0.02)


@pytest.mark.parametrize(
    ("rotor", "less", "words"),
    [
        (0, 0.5, ("mm ahead and", "mm right", "turning clockwise carry 20 % of all thrust more", "gave 50 % less")),
        (1, 0.5, ("mm behind and", "mm right", "turning counter-clockwise carry 20 %", "gave 50 % less")),
    ],
)
def test_words_have_sides_and_no_minus_signs(
    rotor: int, less: float, words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
):
    finding, missing = verdict(monkeypatch, centre=of_weak(rotor, less))
    assert missing is None
    said = finding.reason
    assert [word for word in words if word not in said] == []
    assert "-" not in said.replace("counter-clockwise", "")


def test_a_moved_centre_of_gravity_comes_with_its_rivals(monkeypatch: pytest.MonkeyPatch):
    finding, missing = verdict(monkeypatch, centre=AHEAD)
    assert missing is None
    assert (finding.id, finding.verdict, finding.group) == ("mass.cg", "indistinguishable", ("propulsion.unequal",))
    value, error = finding.values["mass.cg.x"]
    assert (value, error) == (pytest.approx(0.006, abs=1e-4), pytest.approx(UNLIKE * ARM / 2.0, rel=0.2))


@pytest.mark.parametrize("count", [2, 3])
def test_rotors_too_few_for_all_moments_say_nothing_of_a_rotor(count: int, monkeypatch: pytest.MonkeyPatch):
    """No clean vehicle of two or three rotors hovers by thrusts alone, so none is drawn."""
    monkeypatch.setattr("rotorid_torch.trace.balance.balances", lambda model, spec, data, names: flights(*names))
    few, data, none = replace(SPEC, motors=SPEC.motors[:count]), SimpleNamespace(identify=(1, 2, 3)), None
    assert out_of_balance(none, few, data, [4, 5]) == (None, None)  # pyright: ignore[reportArgumentType]


def test_seconds_on_the_ground_do_not_count():
    time, flying = 0.02 * np.arange(500), 1.0 * (np.arange(500) >= 200)
    command = {n: flying * (0.55 if n == "motor1" else 0.5) for n in MOTORS}
    command["motor2"] = command["motor2"] + 0.1 * (1.0 - flying)  # one of them idles
    still = dict.fromkeys(("p", "q", "r", "u"), 1e-12 * np.sin(time))
    data = Dataset.from_arrays({"f": {"time": time, **command, **still}}, identify=["f"], kind="multirotor")
    (balance,) = balances(build(SPEC), SPEC, data, ["f"])
    thrust = torch.tensor([0.55**2, 0.25, 0.25, 0.25], dtype=torch.float64)
    torch.testing.assert_close(balance.centre, (thrust @ LEVERS / thrust.sum()).repeat(6, 1))
    assert (len(balance.turning), len(balance.signals["u", 0.0])) == (6, 6)


FLAPPING, K = "propulsion.flapping", 0.004
"""The effect, and its size in rad/(s m): thrusts balance two millimetres off."""


def tilted(seed: int) -> dict[str, np.ndarray]:
    """A flight whose thrusts balance the moment of flapping blades, besides noise, at changing speed and lift."""
    chance = np.random.default_rng(seed)
    time = 0.02 * np.arange(2000)
    u = 4.0 * np.sin(0.5 * time + chance.uniform(0.0, 6.0)) + 2.0 * np.sin(0.9 * time + chance.uniform(0.0, 6.0))
    lift = 9.80665 * (1.0 + 0.4 * np.sin(0.3 * time))
    share = np.sqrt(lift / 9.80665)
    hover = usual_inflow(SPEC)
    square = 0.5 * (u / hover) ** 2
    v = hover * np.sqrt(np.sqrt(share**4 + square**2) - square)
    tilted = K * u * (share - USUAL_TILT * (v / hover - share))
    front, back = (0.5 * np.sqrt(share**2 * (1.0 - side * tilted / (lift * ARM))) for side in (1.0, -1.0))
    motors = {f"motor{k + 1}": (front if x > 0 else back) for k, (x, _, _) in enumerate(PLACES)}
    noisy = {n: m + 5e-4 * chance.standard_normal(len(time)) for n, m in motors.items()}
    rest = {n: 1e-6 * chance.standard_normal(len(time)) for n in ("v", "w", "p", "q", "r")}
    return {"time": time, "u": u, **noisy, **rest}


@pytest.mark.parametrize(("size", "rows"), [(0.0, ["M"]), (K, []), (1.1 * K, []), (3.0 * K, ["M"])])
def test_what_the_model_has_beside_its_rotors_is_not_missing(size: float, rows: list[str]):
    names = [f"f{k}" for k in range(5)]
    data = Dataset.from_arrays({n: tilted(k) for k, n in enumerate(names)}, identify=names, kind="multirotor")
    moving = ("u", "v", "w", "p", "q", "r")
    spec = replace(SPEC, states=moving, outputs=moving, effects=(FLAPPING,) if size else ())
    model = build(spec)
    if size:
        model.put(model.theta.detach().index_fill(0, torch.tensor(model.parameter_set.index(f"{FLAPPING}.k")), size))
    identified, unseen = balances(model, spec, data, names[:3]), balances(model, spec, data, names[3:])
    assert [going.row for going in going_with(identified, unseen)] == rows


def test_a_wind_tilts_the_discs_from_where_the_vehicle_heads():
    """Motors alike hover in a wind: thrusts miss the balance of flapping, ahead or behind by the heading."""
    names, time = {"north": 0.0, "south": np.pi}, 0.02 * np.arange(400)
    still = {n: 1e-9 * np.sin(time + k) for k, n in enumerate(("u", "v", "w", "p", "q", "r", "phi", "theta"))}
    alike = {n: 0.5 + 1e-9 * np.cos(time + k) for k, n in enumerate(MOTORS)}
    flights = {n: {"time": time, **alike, **still, "psi": psi + 1e-9 * time} for n, psi in names.items()}
    data = Dataset.from_arrays(flights, identify=list(names), kind="multirotor")
    moving = ("u", "v", "w", "p", "q", "r", "phi", "theta")
    spec = replace(
        SPEC,
        states=moving,
        outputs=moving,
        effects=("environment.wind", FLAPPING),
        reference={**SPEC.reference, "psi": 0.0},
    )
    model = build(spec)
    model.start_from({"environment.wind.north": -5.0, f"{FLAPPING}.k": K})
    ahead, behind = (one.centre.mean(dim=0) for one in balances(model, spec, data, list(names)))
    assert float(ahead[0]) > 1e-3
    torch.testing.assert_close(behind[:2], -ahead[:2], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("push", "blown"), [(0.3, False), (-1.5, True)])
def test_a_wind_that_pushes_all_flights_is_a_rival_of_what_the_balance_shows(
    push: float, blown: bool, monkeypatch: pytest.MonkeyPatch
):
    """0.3 m/s2 may be an attitude that is 2 degrees off."""
    centre, _ = verdict(monkeypatch, push=push, centre=AHEAD)
    assert ("environment.wind" in centre.group) == blown
    assert ("pushed by 1.5 m/s²" in centre.reason) == blown
    assert centre.group
    assert centre.verdict == "indistinguishable"


@pytest.mark.parametrize(("by_speed", "words"), [(-1e-3, FLAPPING), (1e-3, "no effect of the library")])
def test_a_moment_that_flapping_would_make_is_said_to_look_like_it(
    by_speed: float, words: str, monkeypatch: pytest.MonkeyPatch
):
    """Blades that flap back raise the nose as the vehicle moves ahead: thrusts balance behind."""
    _, unknown = verdict(monkeypatch, by_speed=by_speed)
    assert unknown.where == "M"
    assert words in unknown.sentence


def test_where_all_is_ordinary_nothing_is_said(monkeypatch: pytest.MonkeyPatch):
    assert verdict(monkeypatch) == (None, None)
