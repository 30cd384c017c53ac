"""The flat state: slices that have names."""

from __future__ import annotations

import pytest
import torch

from rotorid_torch.core.state import State, StateLayout


@pytest.fixture
def layout() -> StateLayout:
    return StateLayout((State("u", "m/s"), State("p", "rad/s"), State("q", "rad/s"), State("a0", "rad")))


def test_names_and_places(layout: StateLayout):
    assert layout.names == ("u", "p", "q", "a0")
    assert len(layout) == 4
    assert layout.places(("a0", "u")) == [3, 0]
    assert layout.has("p", "q")
    assert not layout.has("p", "r")


def test_pick_takes_components_in_the_order_asked(layout: StateLayout):
    x = torch.arange(8.0).view(2, 4)
    assert layout.pick(x, "p", "q").tolist() == [[1, 2], [5, 6]]
    assert layout.pick(x, "a0", "u").tolist() == [[3, 0], [7, 4]]
    assert layout.pick(x, "q").tolist() == [[2], [6]]


def test_neighbours_come_as_a_view(layout: StateLayout):
    x = torch.zeros(4)
    layout.pick(x, "p", "q").fill_(1.0)
    assert x.tolist() == [0, 1, 1, 0]


def test_unknown_states_are_told_with_those_that_exist(layout: StateLayout):
    with pytest.raises(KeyError, match=r"no state among \['r'\].*u, p, q, a0"):
        layout.pick(torch.zeros(4), "r")
    with pytest.raises(ValueError, match="declared twice"):
        StateLayout((State("u"), State("u")))
