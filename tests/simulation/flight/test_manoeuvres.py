"""Names of flights: conditions, groups, lists, and what is no name."""

import numpy as np
import pytest

from rotorid_torch.errors import InputError
from rotorid_torch.simulation.flight.manoeuvres import (
    FLIGHTS,
    GROUPS,
    Condition,
    chosen,
    conditioned,
    groups,
    lists,
    pilot,
)

USUAL = Condition(heading=0.1, height=27.4, speed=0.0)


def test_a_condition_in_the_name_changes_what_it_names():
    """Degrees of heading, metres of height, metres per second."""
    assert conditioned("dbl_lon_p", USUAL) == ("dbl_lon_p", USUAL)
    assert conditioned("dbl_lon_p-90deg", USUAL) == ("dbl_lon_p", Condition(np.pi / 2, 27.4, 0.0))
    assert conditioned("sweep_col-5m-20mps", USUAL) == ("sweep_col", Condition(0.1, 5.0, 20.0))


def test_the_stick_does_not_know_the_condition():
    """The same manoeuvre."""
    time, limits = np.linspace(0.0, 5.0, 200), ((-0.3, 0.2),) * 4
    named = pilot(["dbl_lon_n-180deg", "dbl_lon_n"], time, limits)
    np.testing.assert_array_equal(named[..., 0], named[..., 1])
    assert named.min() < 0.0


def test_groups_expand_and_lists_follow_the_manoeuvre():
    """Order of the lists first; nothing twice; doublets of the other sign validate."""
    names = chosen(["headings", "dbl_lon_n-90deg", "sweep_col", "f321_lon"])
    assert names == ("f321_lon", "sweep_col", *GROUPS["headings"])
    sorted_out = lists(names)
    assert sorted_out["acid"] == ["sweep_col"]
    assert "dbl_lon_n-90deg" in sorted_out["validate"]
    assert sum(map(len, sorted_out.values())) == len(names)
    assert chosen(["all"]) == FLIGHTS
    assert {conditioned(name, USUAL)[1].speed for name in groups(30.0)["speeds"]} == {20.0, 40.0}
    assert {conditioned(name, USUAL)[1].speed for name in groups(0.0)["speeds"]} == {10.0, 20.0}


@pytest.mark.parametrize(
    "name",
    ["loop", "dbl_lon_p-", "dbl_lon_p-0m", "dbl_lon_p-5m-6m", "dbl_lon_p-5km", "dbl_lon_p-1000m", "Headings"],
)
def test_what_is_no_flight_is_refused(name):
    """With what there is."""
    with pytest.raises(InputError, match="there is no flight"):
        chosen(["f321_lon", name])
