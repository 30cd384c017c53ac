"""What the functions of runs take, checked before any work: one check by the name of the argument."""

from typing import Any

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.core.processes.ranks import Ranks
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.run.output.monitor import Monitor


def of_data(argument: Argument, value: Any) -> Dataset:
    """A data set that was loaded.

    Raises InputError: anything else.
    """
    hint = "a Dataset: rotorid.load(path)" if isinstance(value, str) else "a Dataset: load or Dataset.from_arrays"
    return arguments.instance(argument, value, Dataset, hint)


CHECKS = {
    "dataset": of_data,
    "effects": lambda argument, value: [
        arguments.instance(argument, one, str, "ids of effects: control.delay")
        for one in arguments.sequence(argument, value, 'a list of ids: ["control.delay"]')
    ],
    "out": arguments.optional(arguments.place),
    "device": lambda argument, value: arguments.word(argument, value, ("cpu", "cuda")),
    "monitor": arguments.optional(
        lambda argument, value: arguments.instance(argument, value, Monitor, "a Monitor, or an object of a subclass")
    ),
    "ranks": lambda argument, value: arguments.instance(argument, value, Ranks, "Ranks of core.processes.ranks"),
    "hybrid": arguments.flag,
    "resume": arguments.flag,
}
"""By the name of the argument."""


def refuse_arguments(of: str, **values: Any) -> None:
    """Check arguments of a function by their names.

    Raises InputError: the first one that does not fit.
    """
    for key, value in values.items():
        CHECKS[key](Argument(of, key), value)
