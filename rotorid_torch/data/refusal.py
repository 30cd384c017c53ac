"""A declared value that its struct refuses, told as file, key path, what is there and what is allowed."""

import re
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from rotorid_torch.errors import InputError, nearest

T = TypeVar("T")


def convert(value: Any, kind: type[T], file: str | Path, prefix: str) -> T:
    """Convert plain data to a struct, strictly; `prefix` is the key path that leads to it. Raises InputError."""
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise _refusal(str(error), value, kind, file, prefix) from None


def plain_number(value: Any) -> Any:
    """An array or number of NumPy or torch as Python's, for `msgspec.to_builtins`; InputError for what is neither."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise InputError(
        "arrays", "", f"holds {type(value).__name__}", "numbers, text, lists and dicts in what it declares"
    )


def _refusal(message: str, document: Any, kind: Any, file: str | Path, prefix: str) -> InputError:
    """Message of msgspec as file, key path, what is there, and what is allowed."""
    text, _, place = message.partition(" - at `$")
    path = place.rstrip("`").lstrip(".")
    key = ".".join(part for part in (prefix, path) if part)
    steps = [int(s) if s.isdigit() else s for s in re.findall(r"[^.\[\]]+", path)]
    if unknown := re.fullmatch(r"Object contains unknown field `(.*)`", text):
        fields = _fields_at(kind, steps)
        full = f"{key}.{unknown[1]}" if key else unknown[1]
        return InputError(file, full, f"unknown key{nearest(unknown[1], fields)}", f"one of {', '.join(fields)}")
    if missing := re.fullmatch(r"Object missing required field `(.*)`", text):
        allowed = _allowed(_type_at(kind, [*steps, missing[1]]))
        return InputError(file, f"{key}.{missing[1]}" if key else missing[1], "is missing", allowed or "this key")
    refused = _value_at(document, steps)
    allowed = _allowed(_type_at(kind, steps))
    expected = re.sub(r"^Expected ", "", text.split(", got")[0]).replace("`", "").replace(" | null", "")
    return InputError(file, key, f"is {shown(refused)}", allowed or expected)


def shown(value: Any) -> str:
    """Show a value for a message, shortened."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _value_at(document: Any, steps: list[Any]) -> Any:
    for step in steps:
        try:
            document = document[step]
        except (KeyError, IndexError, TypeError):
            return None
    return document


def _type_at(kind: Any, steps: list[Any]) -> Any:
    """Description by msgspec of the type that the steps lead to, or None."""
    info: Any = msgspec.inspect.type_info(kind)
    for step in steps:
        info = _child(_bare(info), step)
    return info


def _bare(info: Any) -> Any:
    while isinstance(info, msgspec.inspect.UnionType | msgspec.inspect.Metadata):
        if isinstance(info, msgspec.inspect.Metadata):
            info = info.type
        else:
            info = next(t for t in info.types if not isinstance(t, msgspec.inspect.NoneType))
    return info


def _child(info: Any, step: Any) -> Any:
    if isinstance(info, msgspec.inspect.StructType):
        return next((f.type for f in info.fields if f.encode_name == step), None)
    if isinstance(info, msgspec.inspect.TupleType) and isinstance(step, int) and step < len(info.item_types):
        return info.item_types[step]
    return getattr(info, "item_type", None)


def _fields_at(kind: Any, steps: list[Any]) -> list[str]:
    info = _bare(_type_at(kind, steps))
    return [f.encode_name for f in getattr(info, "fields", ())]


_WORDS = {
    "StrType": "text",
    "DictType": "a table",
    "StructType": "a table",
    "VarTupleType": "a list",
    "BoolType": "true or false",
}


def _allowed(info: Any) -> str:
    """What a type allows, in words for people: choices, a range with its unit, a list of so many numbers."""
    described = info
    while isinstance(described, msgspec.inspect.UnionType):
        described = next(t for t in described.types if not isinstance(t, msgspec.inspect.NoneType))
    unit = ""
    if isinstance(described, msgspec.inspect.Metadata):
        unit = (described.extra_json_schema or {}).get("description", "")
    bare = _bare(info)
    if isinstance(bare, msgspec.inspect.LiteralType):
        return " or ".join(repr(v) for v in bare.values)
    if isinstance(bare, msgspec.inspect.TupleType):
        nested = isinstance(_bare(bare.item_types[0]), msgspec.inspect.TupleType)
        return f"a list of {len(bare.item_types)} {'rows of 3 numbers' if nested else 'numbers'}"
    if isinstance(bare, msgspec.inspect.FloatType | msgspec.inspect.IntType):
        return _range_words(bare, unit)
    return _WORDS.get(type(bare).__name__, "")


def _range_words(info: Any, unit: str) -> str:
    noun = "a whole number" if isinstance(info, msgspec.inspect.IntType) else "a number"
    low = f"above {info.gt:g}" if info.gt is not None else f"from {info.ge:g}" if info.ge is not None else ""
    high = f"to {info.le:g}" if info.le is not None else ""
    return " ".join(word for word in (noun, low, high, unit) if word)
