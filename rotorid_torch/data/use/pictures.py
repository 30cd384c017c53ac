"""Records as matplotlib figures, of no display and no global state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from torch import Tensor

from rotorid_torch.core import names

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = 3
"""Pictures across each other."""
SIZE = (3.2, 1.7)
"""Of one picture, inches."""


def of_channels(title: str, channels: Mapping[str, Tensor], shown: Sequence[str]) -> Figure:
    """One picture per channel, over the time in s; `shown` names them in order."""
    labels = {name: f"{name}, {unit}" if (unit := names.unit(name)) else name for name in shown}
    return over(title, ("time, s", channels["time"]), {labels[name]: channels[name] for name in shown})


def over(title: str, along: tuple[str, Tensor], columns: Mapping[str, Tensor]) -> Figure:
    """One picture per column (T,), named with its unit, over a label and its values (T,)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    across = min(COLUMNS, max(len(columns), 1))
    rows = -(-max(len(columns), 1) // across)
    figure = Figure(figsize=(SIZE[0] * across, SIZE[1] * rows + 0.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, across, sharex=True, squeeze=False).ravel()
    for axis, (name, values) in zip(axes, columns.items(), strict=False):
        axis.plot(along[1].numpy(), values.numpy(), linewidth=0.8)
        axis.set_ylabel(name)
    for axis in axes[len(columns) :]:
        axis.set_axis_off()
    for axis in axes[-across:]:
        axis.set_xlabel(along[0])
    figure.suptitle(title)
    return figure
