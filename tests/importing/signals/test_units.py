"""Units against what they are by definition; shares of the lists."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotorid_torch import cli
from rotorid_torch.importing.manoeuvres import SHARES, moved, share_out
from rotorid_torch.importing.signals.units import UNITS, find_unit, names_of

KNOWN = {
    "deg": (180.0, math.pi),
    "rpm": (60.0, 2.0 * math.pi),
    "Hz": (1.0, 2.0 * math.pi),
    "kn": (3600.0, 1852.0),
    "ft/min": (60.0, 0.3048),
    "mph": (3600.0, 1609.344),
    "in": (12.0, 0.3048),
    "mg": (1000.0, 9.80665),
    "km/h": (3.6, 1.0),
    "ft lb": (1.0, 1.3558179483314),
    "us": (1500.0, 0.5),
    "%": (50.0, 0.5),
    "mV": (12_000.0, 12.0),
}


@pytest.mark.parametrize("name", KNOWN)
def test_units_are_what_they_are(name: str):
    value, expected = KNOWN[name]
    unit = UNITS[name]
    assert unit.factor * value + unit.offset == pytest.approx(expected)


def test_spellings():
    assert find_unit("deg/s^2") == find_unit("deg/s2") == find_unit("deg/s/s") == UNITS["deg/s²"]
    assert find_unit(" m/s**2 ") == UNITS["m/s²"]
    assert find_unit("furlong") is None
    assert names_of("rad") == ["rad", "deg", "cdeg"]


KINDS = st.frozensets(st.sampled_from(["lon", "lat", "p", "q"]))


@given(st.lists(st.tuples(KINDS, st.floats(1.5, 60.0)), min_size=1, max_size=40))
def test_every_flight_is_in_one_list_and_every_kind_in_identify(drawn: list[tuple[frozenset[str], float]]):
    flights = [(f"f{i}", kinds, seconds) for i, (kinds, seconds) in enumerate(drawn)]
    lists = share_out(flights)
    assert sorted(name for chosen in lists.values() for name in chosen) == sorted(name for name, *_ in flights)
    kinds = {name: kind for name, kind, _ in flights}
    assert frozenset().union(*(kinds[name] for name in lists["identify"])) == frozenset().union(*kinds.values())
    total, longest = sum(s for *_, s in flights), max(s for *_, s in flights)
    length = {name: seconds for name, _, seconds in flights}
    for key in ("validate", "acid"):
        assert sum(length[name] for name in lists[key]) <= SHARES[key] * total + longest


def test_a_control_that_follows_another_is_not_moved_by_that_flight():
    """Pedals that a controller moves with the collective do not stand for a flight of the pedals."""
    time = np.arange(0.0, 15.0, 0.02)
    pulse = np.sign(np.sin(time))
    flights = {
        "col": {"col": pulse, "ped": 0.6 * pulse},
        "ped": {"col": 0.0 * pulse, "ped": pulse},
        "both": {"col": 0.8 * pulse, "ped": 0.8 * pulse},
    }
    assert moved(flights, 0.02) == {"col": {"col"}, "ped": {"ped"}, "both": {"col", "ped"}}


def test_help_tells_the_options(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as leaving:
        cli.main(["import", "--help"])
    told = capsys.readouterr().out
    assert leaving.value.code == 0
    assert all(option in told for option in ("--out", "--map", "--rate", "--split", "--quiet", "--json", "--seed"))
