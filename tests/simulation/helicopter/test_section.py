"""Lift curve: slope below stall, loss beyond, flat plate far beyond."""

import numpy as np

from rotorid_torch.simulation.helicopter.section import Section

SECTION = Section(lift_slope=5.73, stall=0.26, drag=0.009, drag_rise=0.3)


def test_lift_is_linear_below_stall_and_falls_beyond():
    """At 4 degrees the slope, at 18 degrees less than at 12; odd in the angle, drag even."""
    angle = np.deg2rad([4.0, 12.0, 18.0])
    lift, drag = SECTION.coefficients(angle)
    assert abs(lift[0] / (5.73 * angle[0]) - 1.0) < 1e-3
    assert lift[2] < lift[1]
    assert 1.0 < lift[1] < 1.4
    negative, same = SECTION.coefficients(-angle)
    np.testing.assert_allclose(negative, -lift)
    np.testing.assert_allclose(same, drag)
    assert np.all(np.diff(drag) > 0.0)


def test_flat_plate_across_the_flow():
    """At 90 degrees no lift and a drag near 2."""
    lift, drag = SECTION.coefficients(np.array([np.pi / 2]))
    assert abs(lift[0]) < 1e-9
    assert 1.8 < drag[0] < 2.1
