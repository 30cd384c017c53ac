"""The built-in map of SIDPAC's matrix `fdata`, whose columns have one public order.

Source: Morelli and Klein, Aircraft System Identification, 2nd ed., SIDPAC, data in standard configuration.
"""

from collections.abc import Sequence

import numpy as np

from rotorid_torch.importing.signals.mapping import Clock, Entry
from rotorid_torch.importing.signals.plan import Chosen, Plan, has_content, merged, moving
from rotorid_torch.importing.signals.streams import Log

SYSTEM, NAME = "SIDPAC", "fdata"
LEAST = 16
"""Columns up to the three control surfaces."""
SURFACES = ("lon", "lat", "ped")
_NONE = np.zeros(0)
COLUMNS: dict[str, tuple[int, str]] = {
    **{"airspeed": (2, "ft/s"), "beta": (3, "deg"), "alpha": (4, "deg")},
    **{"p": (5, "deg/s"), "q": (6, "deg/s"), "r": (7, "deg/s")},
    **{"phi": (8, "deg"), "theta": (9, "deg"), "psi": (10, "deg")},
    **{"ax": (11, "g"), "ay": (12, "g"), "az": (13, "g")},
    **{"lon": (14, "deg"), "lat": (15, "deg"), "ped": (16, "deg"), "height": (30, "ft")},
    **{"pdot": (42, "deg/s²"), "qdot": (43, "deg/s²"), "rdot": (44, "deg/s²")},
}
"""Column, from 1, and unit of each channel: surfaces of pitch, roll and yaw are the controls."""


def clock() -> Clock:
    """The clock: the first column, in s."""
    return Clock(f"{NAME}[0]", "s")


def is_sidpac(columns: Sequence[str]) -> bool:
    """Whether a file's columns hold such a matrix."""
    return f"{NAME}[{LEAST - 1}]" in columns


def fields(topic: str, names: Sequence[str]) -> list[str]:
    """Fields that the map may need."""
    wanted = {_field(column) for column, _ in COLUMNS.values()}
    return [name for name in names if name in wanted] if not topic and is_sidpac(names) else []


def plan(log: Log) -> Plan:
    """Channels of such a matrix: those that are all zero or not a number, and idle surfaces, were not measured."""
    columns = log.streams["", 0].columns
    found = {
        name: Entry(field, unit)
        for name, (column, unit) in COLUMNS.items()
        if (moving if name in SURFACES else has_content)(columns.get(field := _field(column), _NONE))
    }
    absent = f"{' '.join(n for n in COLUMNS if n not in found)} (zero, not a number or not there)"
    return merged("", [Chosen(found, missing=absent)], ["SIDPAC's fdata: columns 14 to 16 (deg) are lon, lat and ped"])


def _field(column: int) -> str:
    return f"{NAME}[{column - 1}]"
