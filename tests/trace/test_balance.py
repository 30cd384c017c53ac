"""Thrusts out of balance are told with their cause or their rivals; ordinary rotors and chance are not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from rotorid_torch.trace.balance import UNEQUAL, Balance, Standing, going_with, out_of_balance, standing

ARM = 0.033
PLACES = ((1, 1, -1), (-1, 1, 1), (-1, -1, -1), (1, -1, 1))
SPEC: Any = SimpleNamespace(
    motors=[SimpleNamespace(position=(ARM * x, ARM * y, 0.0), spin=s) for x, y, s in PLACES],
    driven=tuple(f"motor{k}" for k in range(1, 5)),
)
LEVERS = torch.tensor([[ARM * x, ARM * y, s] for x, y, s in PLACES], dtype=torch.float64)
MEANS = 20
AHEAD = torch.tensor([0.006, 0.0, 0.0], dtype=torch.float64)


def flight(seed: int, centre: Tensor | None = None, by_speed: float = 0.0) -> Balance:
    chance = torch.Generator().manual_seed(seed)
    speed, other = (torch.randn(MEANS, generator=chance, dtype=torch.float64) for _ in range(2))
    noise = torch.randn(MEANS, 3, generator=chance, dtype=torch.float64) * torch.tensor([1e-4, 1e-4, 3e-3])
    turning = torch.randn(MEANS, 3, generator=chance, dtype=torch.float64)
    made = noise + 1e-4 * turning + (0.0 if centre is None else centre)
    made[:, 0] += by_speed * speed
    return Balance(made, turning, {"u": speed, "v": other})


def flights(*seeds: int, **what: Any) -> list[Balance]:
    return [flight(seed, **what) for seed in seeds]


def stood(*seeds: int, **what: Any) -> Standing | None:
    return standing(SPEC, flights(*seeds, **what), flights(*(1000 + seed for seed in seeds), **what))


def test_a_pitching_moment_by_speed_is_found_and_holds_on_unseen_flights():
    found = going_with(flights(1, 2, by_speed=3e-4), flights(3, 4, by_speed=3e-4))
    assert [(g.row, g.signal) for g in found] == [("M", "u")]
    assert found[0].rest < 0.5 * found[0].without
    assert found[0].rest == pytest.approx(1e-4, rel=0.4)


def test_what_unseen_flights_do_not_show_is_not_told():
    assert going_with(flights(1, 2, by_speed=3e-4), flights(3, 4)) == []
    assert going_with(flights(1, 2), flights(3, 4)) == []


def test_chance_is_told_on_few_of_many_vehicles():
    told = [going_with(flights(4 * k, 4 * k + 1), flights(4 * k + 2, 4 * k + 3)) for k in range(60)]
    assert sum(bool(found) for found in told) <= 4


def test_slow_wandering_is_no_evidence():
    """Neighbouring means that resemble each other are few values, however many they are."""

    def wandering(seed: int) -> Balance:
        chance = torch.Generator().manual_seed(seed)
        slow = torch.randn(2, MEANS, generator=chance, dtype=torch.float64).cumsum(dim=1)
        zero = torch.zeros(MEANS, dtype=torch.float64)
        turning = torch.randn(MEANS, 3, generator=chance, dtype=torch.float64)
        return Balance(torch.stack([slow[0], zero, zero], dim=1), turning, {"u": slow[1]})

    told = [going_with([wandering(2 * k)], [wandering(2 * k + 1)]) for k in range(60)]
    assert sum(bool(found) for found in told) <= 4


@pytest.mark.parametrize("rotor", range(4))
def test_one_weak_rotor_is_told_from_a_centre_of_gravity_elsewhere(rotor: int):
    found = stood(1, 2, 3, centre=0.5 * LEVERS[rotor] / 4)
    assert found is not None
    assert (found.moved_alone, found.rotor) == (False, rotor)
    assert found.less == pytest.approx(0.5, abs=0.02)


def test_a_centre_of_gravity_elsewhere_leaves_yaw_alone():
    found = stood(1, 2, 3, centre=AHEAD)
    assert found is not None
    assert (found.moved_alone, found.rotor) == (True, None)
    assert float(found.centre[0]) == pytest.approx(0.006, abs=1e-4)


def test_ordinary_rotors_do_not_stand_out():
    chance = torch.Generator().manual_seed(0)
    unequal = UNEQUAL * torch.randn(300, 4, generator=chance, dtype=torch.float64)
    told = [stood(k, k + 1, centre=e @ LEVERS / 4) for k, e in enumerate(unequal)]
    assert sum(found is not None for found in told) <= 2


def test_what_unseen_flights_do_not_bear_out_is_not_told():
    assert standing(SPEC, flights(1, 2, centre=AHEAD), flights(3, 4, centre=-AHEAD)) is None


def told(monkeypatch: pytest.MonkeyPatch, **what: Any) -> Any:
    monkeypatch.setattr(
        "rotorid_torch.trace.balance.balances", lambda model, spec, data, names: flights(*names, **what)
    )
    data: Any = SimpleNamespace(identify=(1, 2, 3))
    none: Any = None
    return out_of_balance(none, SPEC, data, [4, 5])  # pyright: ignore[reportArgumentType]


def test_words_name_the_rotor_but_no_effect(monkeypatch: pytest.MonkeyPatch):
    finding, missing = told(monkeypatch, centre=0.5 * LEVERS[2] / 4, by_speed=3e-4)
    assert finding is None
    assert missing.goes_with == "motor3"
    assert "as if the rotor of motor3 gave 50 % less" in missing.sentence
    assert "M: it goes with u" in missing.sentence


def test_a_moved_centre_of_gravity_is_told_with_its_rivals(monkeypatch: pytest.MonkeyPatch):
    finding, missing = told(monkeypatch, centre=AHEAD)
    assert missing is None
    assert (finding.id, finding.verdict, finding.group) == ("mass.cg", "indistinguishable", ("rotors.thrust",))
    value, error = finding.values["mass.cg.x"]
    assert (value, error) == (pytest.approx(0.006, abs=1e-4), pytest.approx(UNEQUAL * ARM / 2.0, rel=0.1))


def test_where_all_is_ordinary_nothing_is_told(monkeypatch: pytest.MonkeyPatch):
    assert told(monkeypatch) == (None, None)
