"""Maps from fields of a log to channels: the short TOML that a user writes, and its check."""

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from rotorid_torch.core import names
from rotorid_torch.core.storage.files import read_file
from rotorid_torch.data.declare import TOML_LIMIT
from rotorid_torch.data.refusal import convert
from rotorid_torch.errors import InputError, nearest
from rotorid_torch.importing.signals import units

Factor = Annotated[float, Meta(ge=-1e12, le=1e12)]

DERIVED = {
    **dict.fromkeys(("q0", "q1", "q2", "q3"), "norm"),
    **dict.fromkeys(("vn", "ve", "vd"), "m/s"),
    **dict.fromkeys(("latitude", "longitude"), "rad"),
}
"""What a map may name besides channels, with its unit: the quaternion from body to north-east-down axes (q0 the scalar)
becomes phi, theta, psi; velocity north, east and down becomes u, v, w; latitude and longitude become north, east."""


class Entry(Struct, frozen=True, forbid_unknown_fields=True):
    """A channel: sign * (scale * field + offset), in `unit`; an empty unit is the channel's own."""

    field: str
    unit: str = ""
    sign: Literal[1, -1] = 1
    scale: Factor = 1.0
    offset: Factor = 0.0


class Clock(Struct, frozen=True, forbid_unknown_fields=True):
    """Which column of a table is time, and its unit; an empty one is that of the column's header, else s."""

    field: str
    unit: Literal["s", "ms", "us", "ns", "days", ""] = ""


@dataclass(frozen=True)
class Form:
    """What a map says of a table of text: rows to skip before it begins, and names of its columns by position."""

    skip_rows: int = 0
    columns: tuple[str, ...] = ()


class Map(Struct, frozen=True, forbid_unknown_fields=True):
    """A whole map.

    Attributes
    ----------
    channels : per channel its field (of a table also its place, from 1), or a table with unit, sign, scale and offset.
    time : clock of a table; a flight log has its own.
    skip_rows : rows of a table before it begins; rows that are no names and no numbers need not be counted.
    columns : names of a table's columns by position, for one without a row of names.
    kind : of vehicle; by the controls where it is empty.
    together : the files are streams of one flight, and a field is named `FILE.field` (the file's name without ending).
    built_in : what the map does not name comes from the map of the log's maker, as all does where it names nothing.
    vehicle : the table of that name, for dataset.toml.
    """

    channels: dict[str, Any] = {}
    time: Any = None
    skip_rows: Annotated[int, Meta(ge=0, le=100_000)] = 0
    columns: tuple[str, ...] = ()
    kind: Literal["helicopter", "multirotor", ""] = ""
    together: bool = False
    built_in: bool = False
    vehicle: dict[str, Any] = {}

    @property
    def takes_built_in(self) -> bool:
        """Whether what it does not name comes from the map of the log's maker."""
        return self.built_in or not self.channels

    def entries(self, file: str | Path = "mapping") -> dict[str, Entry]:
        """Channels with their entries written out."""
        written = {name: _written(e) for name, e in self.channels.items()}
        return {name: convert(e, Entry, file, f"channels.{name}") for name, e in written.items()}

    def form(self) -> Form:
        """What the map says of a table's beginning."""
        return Form(self.skip_rows, self.columns)

    def clock(self, file: str | Path = "mapping") -> Clock | None:
        """The clock written out."""
        written = _written(self.time)
        return None if written is None else convert(written, Clock, file, "time")


def _written(entry: Any) -> Any:
    """An entry as a table; a field may be a place, from 1."""
    table = dict(entry) if isinstance(entry, Mapping) else entry
    place = table.get("field") if isinstance(table, dict) else table
    if isinstance(place, int) and not isinstance(place, bool):
        place = str(place)
    if isinstance(table, dict):
        return table | {"field": place} if "field" in table else table
    return {"field": place} if isinstance(place, str) else table


def read_map(source: str | Path | Mapping[str, Any]) -> Map:
    """Map from a TOML file, or from the same as a dict. Raises InputError with the key at fault."""
    file: str | Path = "mapping"
    document: Any = source
    if isinstance(source, str | Path):
        file = source
        document = _toml(Path(source))
    user_map = convert(document, Map, file, "")
    user_map.clock(file)
    for name, entry in user_map.entries(file).items():
        check_unit(name, entry, file)
    return user_map


def _toml(file: Path) -> dict[str, Any]:
    content = read_file(file, "a map in TOML", TOML_LIMIT)
    try:
        return tomllib.loads(content.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise InputError(file, "", f"is not TOML: {error}", "a map with a table [channels]") from None


def measures(name: str) -> str:
    """Unit of a channel or of what becomes one; empty for somebody's own name."""
    return DERIVED.get(name) or ("norm" if names.is_motor(name) else names.unit(name))


def check_unit(name: str, entry: Entry, file: str | Path, key: str = "") -> None:
    """Raise InputError where an entry's unit is unknown or does not measure what the channel is.

    key : what of the file has the unit; by default the channel's entry of a map.
    """
    if not entry.unit:
        return
    unit, key = units.find_unit(entry.unit), key or f"channels.{name}.unit"
    quantity = measures(name)
    allowed = ("rad", "m", "norm") if name in names.STICKS else (quantity,) if quantity else ()
    fitting = [n for measure in allowed for n in units.names_of(measure)] or list(units.UNITS)
    if unit is None:
        wrong = f"'{entry.unit[:40]}' is not known{nearest(entry.unit, fitting)}"
        raise InputError(file, key, wrong, f"one of {', '.join(fitting)}")
    if allowed and unit.measures not in allowed:
        raise InputError(file, key, f"'{entry.unit}' does not measure {name}", f"one of {', '.join(fitting)}")


def unknown_names(entries: Mapping[str, Entry]) -> Iterator[str]:
    """Sentences on channels that nothing uses."""
    listed = [*names.CHANNELS, *DERIVED, "motor1", "omega1"]
    for name in entries:
        if name not in DERIVED and names.channel(name) is None:
            yield f"channel '{name}' is not known{nearest(name, listed)}: it is kept and not used"
