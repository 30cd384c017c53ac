"""What a model gives at measured states, sample by sample: nothing is integrated, so that no error grows."""

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import torch
from torch import Tensor

from rotorid_torch.core.names import RATES, SPECIFIC_FORCES
from rotorid_torch.core.native.build import compiled_or_none
from rotorid_torch.core.native.points import PointFunction
from rotorid_torch.model.model import ANGULAR_ACCELERATIONS, Model

Record = tuple[Tensor, Tensor, float]
"""States [T, nx] and inputs [T, nu] behind the control path of a flight, and s between its samples."""


class Accelerations:
    """Angular accelerations, specific forces at the IMU and rotor speeds of a model at given body states and inputs.

    names : what it gives; a rate's name is that of its acceleration (pdot qdot rdot).
    """

    def __init__(self, model: Model) -> None:
        forces = model.layout.has("u") or not set(SPECIFIC_FORCES).isdisjoint(model.body.outputs)
        speeds = tuple(o for o in model.body.outputs if o.startswith("omega"))
        self.names = (*ANGULAR_ACCELERATIONS, *(SPECIFIC_FORCES if forces else ()), *speeds)
        self.model = copy.copy(model)
        self.model.body = replace(model.body, outputs=(*self.names, RATES[2]))

    def __call__(self, theta: Tensor, states: Tensor, taped: Tensor, dt: float) -> dict[str, Tensor]:
        """Values [..., T] by name at states [T, nx] and inputs [T, nu] behind the control path.

        The states' rates are those of the body, as a gyro tells them, and not what is left of them where spinning-up
        rotors take their share. theta : [P], or [..., 1, P] for many at once.
        """
        return dict(zip(self.names, self.rows(theta, states, taped, dt).unbind(-2), strict=True))

    def rows(self, theta: Tensor, states: Tensor, taped: Tensor, dt: float) -> Tensor:
        """The same side by side [..., n, T]."""
        outputs = self.model.outputs_at(theta, states, taped, dt)
        share = self._share(outputs, states)
        if bool((share != 0.0).any()):
            outputs = self.model.outputs_at(theta, self._less(states, share), taped, dt)
        return self._with_share(torch.cat([outputs[..., :-1], share[..., None]], dim=-1).mT, dt)

    @cached_property
    def compiled(self) -> PointFunction | None:
        """Values and derivatives in native code; None where effects follow the motion, or native code is not known."""
        theta = self.model.theta
        if any(map(self.model.follows, self.model.chain)):
            return None

        def at(x: Tensor, u: Tensor, theta: Tensor) -> Tensor:
            share = self._share(self.model.outputs_at(theta, x, u), x)
            return torch.cat([self.model.outputs_at(theta, self._less(x, share), u)[..., :-1], share[..., None]])

        slow = "accelerations are computed in torch, many times slower than compiled"
        return compiled_or_none(lambda: PointFunction.of(at, *self.model.reference_point, theta.detach()), slow, theta)

    def at_each(self, thetas: Tensor, records: Sequence[Record]) -> list[Tensor]:
        """Rows [S, n, T] of each record at many thetas [S, P] of one control path."""
        if self.compiled is None:
            every = (self.rows(thetas[:, None], *record) for record in records)
            return [rows.expand(len(thetas), *rows.shape[-2:]) for rows in every]
        points = self._points(records)
        return self._of_records(torch.stack([self.compiled(theta, *points)[0] for theta in thetas]), records)

    def linear(self, theta: Tensor, records: Sequence[Record], places: Sequence[int]) -> list[tuple[Tensor, Tensor]]:
        """Values [n, T] of each record at one theta [P], and their derivatives by the parameters at these places.

        Only where `compiled`.
        """
        assert self.compiled is not None
        both = (self._of_records(part, records) for part in self.compiled(theta, *self._points(records), places))
        return list(zip(*both, strict=True))

    @staticmethod
    def _points(records: Sequence[Record]) -> tuple[Tensor, Tensor]:
        """States and inputs of all records, one behind the other: a call has a price of its own."""
        return torch.cat([states for states, _, _ in records]), torch.cat([taped for _, taped, _ in records])

    def _of_records(self, rows: Tensor, records: Sequence[Record]) -> list[Tensor]:
        """Rows [..., n, T] of each record, of those with the share of the yaw rate of all records."""
        parts = rows.split([len(states) for states, _, _ in records], dim=-1)
        return [self._with_share(part, dt) for part, (_, _, dt) in zip(parts, records, strict=True)]

    def inside(self, states: Tensor, taped: Tensor, dt: float) -> Tensor:
        """The model's states [T, nx]: rates are those of the body, as measured; the effects' states follow the motion.

        States that have a channel stay as they are.
        """
        outputs = self.model.outputs_at(self.model.theta, states, taped, dt)
        states = self._less(states, self._share(outputs, states))
        signals = self.model.frame(self.model.theta, states, taped, dt)[0].signals
        for place, state in enumerate(self.model.layout.states):
            if place >= len(self.model.body.states) and state.channel is None:
                states[..., place] = signals[state.name]
        return states

    def _share(self, outputs: Tensor, states: Tensor) -> Tensor:
        """Of the yaw rate, by the rotors' momentum [...]."""
        return outputs[..., -1] - states[..., self._yaw]

    def _with_share(self, rows: Tensor, dt: float) -> Tensor:
        """Rows [..., n, T] of those with the share of the yaw rate behind them; its rate adds to the acceleration."""
        rows, share = rows[..., :-1, :], rows[..., -1, :]
        if bool(share.any()):
            rows = rows.clone()
            rows[..., self.names.index("rdot"), :] += torch.gradient(share, spacing=dt, dim=-1)[0]
        return rows

    @property
    def _yaw(self) -> int:
        return self.model.layout.places(RATES[2:])[0]

    def _less(self, states: Tensor, share: Tensor) -> Tensor:
        """States whose yaw rate is less by a share [...]."""
        every, yaw = states.expand(*share.shape, -1), self._yaw
        return torch.cat([every[..., :yaw], (every[..., yaw] - share)[..., None], every[..., yaw + 1 :]], dim=-1)
