"""What is handed over to another tool."""

from collections.abc import Sequence
from dataclasses import dataclass

from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.model.model import Model
from rotorid_torch.report.records import ParameterRecord


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
