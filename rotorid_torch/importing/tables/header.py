"""Where a table of text begins: rows before the names, names with units in brackets, names given by position."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass

from rotorid_torch.data.reading.read import number_of
from rotorid_torch.importing.signals import units

MISSING = frozenset(
    (
        *("", "nan", "-nan", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind"),
        *("null", "none", "na", "n/a", "-", "--", "---", "#n/a", "#value!", "#num!", "#div/0!", "missing", "?"),
    )
)
"""What stands for a missing sample, in small letters."""
MARKS = ",;\t|"
NUMERIC_ROWS = 2
"""Rows of numbers, with as many fields, that make the beginning of a table."""
LOOKED_AT = 2000
"""Lines among which a table must begin."""
_WORD = re.compile(r"[^\s\[({]+(?:\s*[\[({][^\])}]*[\])}])?|[\[({][^\])}]*[\])}]")
_BY_POINTS = re.compile(r"(?<![\d.,])[1-9]\d{0,2}(?:\.\d{3})+(?![\d.])")
_BY_COMMAS = re.compile(r"(?<![\d.,])[1-9]\d{0,2}(?:,\d{3})+(?![\d,])")
_POINT, _COMMA = re.compile(r"(?<![\d.,])\d+\.\d+(?![\d.,])"), re.compile(r"\d,\d")
_FORTRAN = re.compile(r"(\d\.?)[Dd](?=[+-]?\d)")


@dataclass(frozen=True)
class Header:
    """How a table begins: its mark (None for blanks), its names, the line (from 0) of its first row, rows before."""

    mark: str | None
    names: list[str]
    first: int
    before: list[list[str]]


def split(line: str, mark: str | None) -> list[str]:
    """Fields of a line; between blanks a unit in brackets belongs to the name before."""
    if mark is None:
        return [match[0] for match in _WORD.finditer(line)]
    try:
        return [field.strip() for field in next(csv.reader([line], delimiter=mark), [])]
    except csv.Error:
        return line.split(mark)


def numeric(line: str, mark: str | None) -> str:
    """A row with points for decimal commas, thousands as one number (1.234,5; 1,234.5), and `e` for Fortran's D.

    Commas stand between thousands where a point does before decimals, and before decimals else; points likewise.
    """
    if mark != "," and "," in line:
        by_commas, by_points = (
            pattern.sub(lambda group: re.sub("[.,]", "", group[0]), line) for pattern in (_BY_COMMAS, _BY_POINTS)
        )
        if _POINT.search(by_commas) and not _COMMA.search(by_commas):
            line = by_commas
        else:
            line = (line if _POINT.search(by_points) else by_points).replace(",", ".")
    return _FORTRAN.sub(r"\1e", line) if "D" in line or "d" in line else line


def value_of(field: str) -> float:
    """Number of a field, which may stand in quotation marks for its commas; ValueError for none, and for 1,234."""
    try:
        return number_of(field)
    except ValueError:
        if "," not in field or _BY_COMMAS.fullmatch(field.lstrip("+-")):
            raise
        return number_of(numeric(field, None))


def is_number(field: str) -> bool:
    """Whether a field is a number."""
    try:
        value_of(field)
    except ValueError:
        return False
    return True


def find_header(lines: Sequence[str], columns: Sequence[str] = ()) -> Header | None:
    """Header of a table among its lines; None where it has neither names nor numbers.

    `columns` are names by position, where a map gives them.
    """
    filled = [index for index, line in enumerate(lines[:LOOKED_AT]) if line.strip()]
    if not filled:
        return None
    head = _bare(lines[filled[0]])
    mark = _mark(head)
    names = split(head, mark)
    after = filled[1] if len(filled) > 1 else len(lines)
    start = _first_row(lines, filled) or _first_row(lines, filled, texts=True)
    if start is None or (not columns and _plain(names, start) and start[1] == mark):
        if columns:
            return Header(mark, names, filled[0], [])
        full, understood = _with_units(names, split(_bare(lines[after]), mark) if after < len(lines) else [])
        return Header(mark, full or names, filled[2] if understood and len(filled) > 2 else after, [])
    at, mark, count = start
    rows = [_above(_bare(lines[index]), mark, count) for index in filled[:at]]
    if columns:
        return Header(mark, [*columns, *map(str, range(len(columns) + 1, count + 1))][:count], filled[at], rows)
    above = [row for row in rows[-2:] if len(row) == count]
    if rows and len(rows[-1]) != count and len(rows[-1]) > 1 and at == 1:
        return Header(mark, rows[-1], filled[at], [])
    if not above or len(rows[-1]) != count:
        return Header(mark, [str(number) for number in range(1, count + 1)], filled[at], rows)
    full, _ = _with_units(above[0], above[1]) if len(above) == 2 else ([], False)
    return Header(mark, full or above[-1], filled[at], rows)


def _above(line: str, mark: str | None, count: int) -> list[str]:
    """Fields of a line above the numbers; a comment's names stand between blanks, whatever the numbers' mark."""
    fields, words = split(line, mark), split(line, None)
    return words if len(fields) != count == len(words) else fields


def _bare(line: str) -> str:
    return line.lstrip("#% \t")


def _mark(line: str) -> str | None:
    """What separates the fields of a line; None for blanks. Between numbers a comma may be that of decimals."""
    decimals = (mark for mark in ";\t" if mark in line and "," in line)
    if of_numbers := next((mark for mark in decimals if _numbers(line, mark)), None):
        return of_numbers
    mark = max(MARKS, key=line.count)
    return mark if mark in line else None


def _plain(names: Sequence[str], start: tuple[int, str | None, int]) -> bool:
    """Whether the first line is the header: names, each once, as many as the rows have fields, no key and its value."""
    words = not any(is_number(name) for name in names) and (start[0] == 1 or len({*names}) == len(names))
    return words and len(names) == start[2] and (len(names) > 2 or start[0] == 1)


def _first_row(lines: Sequence[str], filled: Sequence[int], texts: bool = False) -> tuple[int, str | None, int] | None:
    """Place among the kept lines of the first row of numbers, its mark and its number of fields.

    `texts`: the row may hold words too (a flight mode), after a number and in less than half of its fields.
    """
    for at, index in enumerate(filled):
        mark = _mark(lines[index])
        count = _numbers(lines[index], mark, texts)
        following = filled[at + 1 : at + NUMERIC_ROWS]
        if count and following and all(_numbers(lines[i], mark, texts) == count for i in following):
            return at, mark, count
    return None


def _numbers(line: str, mark: str | None, texts: bool = False) -> int:
    """Number of fields of a row of numbers, two at least; 0 where the line is none."""
    fields = split(numeric(line.strip(), mark), mark)
    present = [field for field in fields if field.lower() not in MISSING]
    words = sum(not is_number(field) for field in present)
    most = len(present) / 2 if texts and present and is_number(present[0]) else 0.5
    return len(fields) if len(fields) > 1 and present and words < most else 0


def _with_units(names: Sequence[str], row: Sequence[str]) -> tuple[list[str], bool]:
    """Names with the units of the row after them in brackets, and whether all of these are known.

    A row is of units where at least half of its fields are, else there is none; a unit in the name itself comes first.
    """
    stripped = [units.in_header(name, field.strip("[]() ")) for name, field in zip(names, row, strict=False)]
    recognised = {field for field in stripped if units.find_unit(field) or units.clock_unit(field)} - {"-"}
    fitting = [field if field in recognised else "" for field in stripped]
    present = [field for field in stripped if field and field != "-"]
    if len(row) != len(names) or not present or 2 * sum(map(bool, fitting)) < len(present):
        return [], False
    bare = [name if "[" in name or "(" in name else "" for name in names]
    full = [b or (f"{name} [{unit}]" if unit else name) for b, name, unit in zip(bare, names, fitting, strict=True)]
    return full, sum(map(bool, fitting)) == len(present)
