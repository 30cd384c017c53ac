"""What is handed over to another tool."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec

from rotorid_torch.effects.registry import of_others, registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.report.records import ParameterRecord
from rotorid_torch.validate.rotor_moments import silent_moments

BATTERY = "voltage"
"""An input of every multirotor that records it, which only some effects read."""


@dataclass(frozen=True)
class Subject:
    """A model and what is said of it.

    title : names it. step : sample interval of its flights, s. tool : the program that wrote it, with its version.
    parameters : with standard errors; none where a model comes without its run.
    """

    model: Model
    spec: ModelSpec
    title: str
    step: float
    tool: str
    parameters: Sequence[ParameterRecord] = ()

    def unit(self, control: str) -> str:
        """Unit of a control, as the data set declares it."""
        return self.spec.control_units.get(control, "")

    def driven(self) -> "Subject":
        """The same without a battery's voltage that nothing in the model reads."""
        read = any(BATTERY in registered()[e].averages or e in of_others() for e in self.spec.effects)
        if read or BATTERY not in self.spec.inputs:
            return self
        inputs = tuple(name for name in self.spec.inputs if name != BATTERY)
        spec = msgspec.structs.replace(self.spec, inputs=inputs)
        model = build(spec)
        model.load_state_dict(self.model.state_dict())
        return replace(self, model=model, spec=spec)

    @property
    def doubt(self) -> str | None:
        """What whoever takes the model must know of it."""
        silent = ", ".join(silent_moments(self.spec))
        why = "flights do not tell what the rotors do there, or contradict the declared vehicle (the report says which)"
        return f"{silent} held at zero: {why}; the model holds these rates whatever the motors do" if silent else None
