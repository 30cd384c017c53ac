"""Channels over time as a matplotlib figure, of no display and no global state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from torch import Tensor

from rotorid_torch.core import names

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = 3
"""Pictures beside each other."""
SIZE = (3.2, 1.7)
"""Of one picture, inches."""


def of_channels(title: str, channels: Mapping[str, Tensor], shown: Sequence[str]) -> Figure:
    """One picture per channel, over the time in s; `shown` names them in order."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(COLUMNS, max(len(shown), 1))
    rows = -(-max(len(shown), 1) // columns)
    figure = Figure(figsize=(SIZE[0] * columns, SIZE[1] * rows + 0.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
    for axis, name in zip(axes, shown, strict=False):
        axis.plot(channels["time"].numpy(), channels[name].numpy(), linewidth=0.8)
        listed = names.channel(name)
        axis.set_ylabel(f"{name}, {listed.unit}" if listed is not None and listed.unit else name)
    for axis in axes[len(shown) :]:
        axis.set_axis_off()
    for axis in axes[-columns:]:
        axis.set_xlabel("time, s")
    figure.suptitle(title)
    return figure
