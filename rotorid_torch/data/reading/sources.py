"""Where a data set comes from: a folder with dataset.toml, or arrays in memory with a document like it."""

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.core.storage.atomic import restore
from rotorid_torch.core.storage.paths import nearest_path
from rotorid_torch.data.declare import declare, read_declaration
from rotorid_torch.data.facts import Facts
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.on_demand import OnDemand
from rotorid_torch.data.reading import suspicion
from rotorid_torch.data.reading.contents import Contents, Origin, assembled
from rotorid_torch.data.reading.grid import make_flight
from rotorid_torch.data.reading.read import find_flight, parse_flight, read_flight, take_arrays
from rotorid_torch.data.refusal import plain_number
from rotorid_torch.errors import InputError


def from_folder(path: str | Path) -> Contents:
    """Read a folder; each flight is read once for its facts, and again when it is asked for."""
    folder = arguments.place(Argument("load", "path"), path)
    if folder.name == "dataset.toml":
        folder = folder.parent
    restore(folder)
    if not os.path.isdir(folder):
        wrong = "is not a folder" if os.path.exists(folder) else f"there is no such folder{nearest_path(folder)}"
        raise InputError(folder, "", wrong, f"a data set's folder{_around(folder)}")
    toml = folder / "dataset.toml"
    if not os.path.lexists(toml):
        wrong = "is a run, not a data set" if (folder / "report.json").exists() else "holds no dataset.toml"
        expected = f"a data set: a folder with dataset.toml and flights/NAME.npz{_around(folder)}"
        raise InputError(folder, "", wrong, expected)
    declaration, content = read_declaration(toml)
    digest = hashlib.sha256(content)
    digests: dict[str, bytes] = {}
    units = declaration.units()
    flights = OnDemand(declaration.flights.all(), lambda name: _again(name, places[name], digests[name], units))
    places, facts, warnings = {}, {}, []
    for name in declaration.flights.all():
        file = find_flight(folder, name)
        data = read_flight(file)
        digest.update(data)
        digests[name] = hashlib.sha256(data).digest()
        flight, wrong = make_flight(name, parse_flight(file, data), file, units)
        facts[name], places[name] = _facts(flight, file), file
        flights.keep(name, flight)
        warnings += wrong
    return assembled(declaration, flights, facts, Origin(folder, toml, places, digest.hexdigest()), warnings)


def _around(place: Path) -> str:
    """Hint at the data set that a folder or file is a part of; empty where it is of none."""
    around = next((p for p in place.parents[:2] if (p / "dataset.toml").is_file()), None)
    return "" if around is None else f", as '{around}' is"


def from_document(flights: Mapping[str, Mapping[str, Any]], document: Mapping[str, Any]) -> Contents:
    """Take arrays, declared by a document of dataset.toml's form; its tables may be structs, or None."""
    flights = arguments.instance(Argument("arrays", "flights"), flights, Mapping, "a dict of channels by flight")
    named = 'a list of names of flights: ["..."]'
    lists = {key: arguments.sequence(Argument("arrays", key), of, named) for key, of in document["flights"].items()}
    tables = {key: _plain(document[key] or {}) for key in ("vehicle", "controls", "channels", "model")}
    document = {**document, **tables, "flights": lists}
    declaration = declare(document, "arrays")
    digest = hashlib.sha256(json.dumps(document, sort_keys=True).encode())
    flown, facts, warnings = {}, {}, []
    places: dict[str, str | Path] = {name: f"arrays: flight {name}" for name in declaration.flights.all()}
    for name, place in places.items():
        if name not in flights:
            expected = f"flights of the lists; there are {arguments.listed(map(str, flights)) or 'none'}"
            raise InputError("arrays", "flights", f"there is no flight '{name}'", expected)
        arrays = take_arrays(flights[name], str(place))
        for channel, values in arrays.items():
            digest.update(channel.encode() + values.tobytes())
        flown[name], remarks = make_flight(name, arrays, place, declaration.units())
        facts[name] = _facts(flown[name], place)
        warnings += remarks
    return assembled(declaration, flown, facts, Origin(None, "arrays", places, digest.hexdigest()), warnings)


def _again(name: str, file: Path, digest: bytes, units: Mapping[str, str]) -> Flight:
    """Read a flight once more; InputError where its file is no longer what it was."""
    data = read_flight(file)
    if hashlib.sha256(data).digest() != digest:
        raise InputError(file, "", "has changed since the data set was loaded", "a file that stays until the run ends")
    return make_flight(name, parse_flight(file, data), file, units)[0]


def _facts(flight: Flight, file: str | Path) -> Facts:
    """What later steps want to know without the samples, where these make sense."""
    suspicion.refuse_degrees_of_attitude(flight, file)
    return Facts.of(flight)


def _plain(table: Any) -> Any:
    return (
        msgspec.to_builtins(dict(table) if isinstance(table, Mapping) else table, str_keys=True, enc_hook=plain_number)
        if isinstance(table, msgspec.Struct | Mapping | list | tuple)
        else table
    )
