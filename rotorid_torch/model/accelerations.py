"""What a model gives at measured states, sample by sample: nothing is integrated, so that no error grows."""

import copy
from dataclasses import replace

import torch
from torch import Tensor

from rotorid_torch.core.names import RATES, SPECIFIC_FORCES
from rotorid_torch.model.model import ANGULAR_ACCELERATIONS, Model


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
        outputs = self.model.outputs_at(theta, states, taped, dt)
        yaw = self._yaw(states)
        share = outputs[..., -1] - yaw  # of the rate by the rotors' momentum
        if bool((share != 0.0).any()):
            outputs = self.model.outputs_at(theta, self._less(states, share), taped, dt)
        values = dict(zip(self.names, outputs.unbind(-1), strict=False))
        values["rdot"] = values["rdot"] + torch.gradient(share, spacing=dt, dim=-1)[0]
        return values

    def inside(self, states: Tensor, taped: Tensor, dt: float) -> Tensor:
        """The model's states [T, nx]: rates are those of the body, as measured; the effects' states follow the motion.

        States that have a channel stay as they are.
        """
        outputs = self.model.outputs_at(self.model.theta, states, taped, dt)
        states = self._less(states, outputs[..., -1] - self._yaw(states))
        signals = self.model.frame(self.model.theta, states, taped, dt)[0].signals
        for place, state in enumerate(self.model.layout.states):
            if place >= len(self.model.body.states) and state.channel is None:
                states[..., place] = signals[state.name]
        return states

    def _yaw(self, states: Tensor) -> Tensor:
        return self.model.layout.pick(states, RATES[2])[..., 0]

    def _less(self, states: Tensor, share: Tensor) -> Tensor:
        place = self.model.layout.places(RATES[2:])[0]
        inside = states.expand(*share.shape, -1).clone()
        inside[..., place] -= share
        return inside
