"""What a measurement is given: where data and anchors are, how often to repeat, which rows are wanted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmark.rows import Figure, NotMeasured

Measured = dict[str, Figure | str]
"""A figure by the row's name, or why there is none."""


@dataclass(frozen=True)
class Setting:
    """Of one run of the benchmark.

    anchors, data : folders, None where there are none. folder : a temporary place. tell : takes profiles.
    """

    anchors: Path | None
    data: Path | None
    repeats: int
    quick: bool
    full: bool
    profile: bool
    wanted: frozenset[str]
    folder: Path
    tell: Callable[[str], None]

    def dataset(self) -> Path:
        """The data set.

        Raises
        ------
        NotMeasured : there is none.
        """
        if self.data is None or not (self.data / "dataset.toml").is_file():
            raise NotMeasured("no data set (--data DIR)")
        return self.data
