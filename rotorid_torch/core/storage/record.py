"""Plain records of a file: numbers that are not finite are absent."""

import math
from typing import Annotated

import msgspec

Number = float | None
Size = Annotated[float, msgspec.Meta(ge=0)] | None
"""A number that is not negative: an error, a duration, a score."""
AtMostOne = Annotated[float, msgspec.Meta(le=1)] | None
Share = Annotated[float, msgspec.Meta(ge=0, le=1 + 1e-9)] | None


def _finite(value: object) -> object:
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None  # a plain number, whatever library it comes from
    if isinstance(value, tuple):
        return tuple(_finite(item) for item in value)
    return value


class Record(msgspec.Struct, frozen=True, kw_only=True):
    """A part of a file; numbers that are not finite become None."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            msgspec.structs.force_setattr(self, name, _finite(getattr(self, name)))
