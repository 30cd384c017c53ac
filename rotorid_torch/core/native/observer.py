"""A model that follows flights with known gains, in native code: whitened innovations and their normal equations."""

import ctypes
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from rotorid_torch.core.native.build import address, library
from rotorid_torch.core.native.dynamics import Dynamics
from rotorid_torch.core.native.innovations import FlightsToFollow


@dataclass(frozen=True, eq=False)
class Gains:
    """How a filter followed flights F of T samples: gain [F, T, nx, ny], and white [F, T, ny, ny].

    white' white is the inverse of the innovations' covariance; both have zeros where a measurement is missing.
    """

    gain: Tensor
    white: Tensor


Filled = tuple[Tensor | None, Tensor | None]


@dataclass(frozen=True, eq=False)
class Observer:
    """x[k] + K[k] (y[k] - h(x[k])) goes on by the model's own step; unknowns are initial states and parameters."""

    dynamics: Dynamics

    @cached_property
    def code(self) -> tuple[str, Tensor]:
        """C++, and the numbers in it."""
        text, numbers = self.dynamics.sensitivity
        return text.replace('#include "sensitivity.h"', '#include "observer.h"'), numbers

    def cost(self, theta: Tensor, x0: Tensor, flights: FlightsToFollow, gains: Gains, threads: int = 1) -> Tensor:
        """Half of the sum of squared whitened innovations [F] from initial states x0 [F, nx]; P0 is not looked at."""
        return self._called(theta, x0, flights, gains, threads)

    def normal_equations(
        self, theta: Tensor, x0: Tensor, flights: FlightsToFollow, gains: Gains, threads: int = 1
    ) -> Tensor:
        """Products of the rows' columns of each flight [F, m, m]: initial states, parameters, innovation."""
        n = len(self.dynamics.columns.order())
        H = torch.zeros(len(x0), n, n, dtype=torch.float64)
        self._called(theta, x0, flights, gains, threads, (H, None))
        return H + H.triu(1).mT

    def rows(self, theta: Tensor, x0: Tensor, flights: FlightsToFollow, gains: Gains, threads: int = 1) -> Tensor:
        """The rows themselves [F, T, ny, m], zero beyond a flight's end."""
        rows = torch.zeros(*flights.outputs.shape, len(self.dynamics.columns.order()), dtype=torch.float64)
        self._called(theta, x0, flights, gains, threads, (None, rows))
        return rows

    def _called(
        self,
        theta: Tensor,
        x0: Tensor,
        flights: FlightsToFollow,
        gains: Gains,
        threads: int,
        filled: Filled = (None, None),
    ) -> Tensor:
        """Cost [F]; what is to be filled besides are normal equations, or rows."""
        source, numbers = self.code
        count, samples, _ = flights.outputs.shape
        order, cost = self.dynamics.columns.order(), torch.zeros(count, dtype=torch.float64)
        theta, x0 = torch.cat([theta, numbers]).contiguous(), x0.contiguous()
        path = self.dynamics.columns.padded(flights.path)
        gain, white = gains.gain.contiguous(), gains.white.contiguous()
        records = flights.length, flights.controls, path, flights.outputs, gain, white, x0, theta, cost
        places, results = [address(a) for a in records], [address(a) for a in (order, *filled)]
        library(source).followed(count, samples, ctypes.c_double(flights.dt), *places, len(order), *results, threads)
        return cost
