"""The simulator's own time loop: classical Runge-Kutta over a batch of flights, in numpy.

Thousands of small steps on small arrays cost mostly call overhead, which numpy has least of; and an integrator that is
not the identification's keeps the flight test independent of it.
"""

from collections.abc import Callable

from rotorid_torch.simulation.rigid import Array

Slope = Callable[[Array, Array], Array]
"""slope(x, u): rates of the states x [states, flight] under the inputs u [inputs, flight]."""


def runge_kutta(slope: Slope, x: Array, first: Array, inputs: tuple[Array, Array, Array], dt: float) -> Array:
    """One step of the classical fourth-order method.

    first : slope at the start (the caller has it already, or wants its by-products).
    inputs : at the start, in the middle and at the end of the step.

    Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, table 1.2.
    """
    second = slope(x + (0.5 * dt) * first, inputs[1])
    third = slope(x + (0.5 * dt) * second, inputs[1])
    fourth = slope(x + dt * third, inputs[2])
    return x + (dt / 6.0) * (first + 2.0 * (second + third) + fourth)
