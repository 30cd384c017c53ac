"""CSV block by block: memory holds the wanted columns and one block of text."""

import codecs
import csv
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from rotorid_torch.core.storage.files import open_file
from rotorid_torch.data.reading.read import CHANNELS
from rotorid_torch.errors import InputError
from rotorid_torch.importing.autopilots import blackbox
from rotorid_torch.importing.signals.mapping import Clock, Form
from rotorid_torch.importing.signals.streams import TOLD, Choose, Log
from rotorid_torch.importing.tables.columns import (
    AS_DATES,
    in_either_order,
    is_clock,
    seconds_of,
    table_log,
    time_of_day,
)
from rotorid_torch.importing.tables.header import MISSING, Header, find_header, is_number, numeric, value_of

BLOCK = 4 * 2**20
"""Bytes read at a time; also the longest line."""
PRINTED = {0x2212: "-", 0xA0: None, 0x2009: None, 0x202F: None}
"""The minus sign of print, and the blanks between thousands that break no line."""
CONTROLS = frozenset({*range(32), *range(0x7F, 0xA0)} - {*b"\t\n\r\f"})
"""Bytes that are no text in Latin-1."""


def read_csv(
    file: Path, choose: Choose, clock: Clock | None = None, block: int = BLOCK, form: Form | None = None
) -> Log:
    """Read a table with a row of names; commas, semicolons, tabs or blanks between the fields.

    Rows before the names, a row of units after them and units in brackets are understood; `form` says what a map does:
    how many rows to skip, and names by position.

    Raises InputError where a wanted field is no number, a row has another number of fields, or no column is the clock.
    """
    try:
        return _read(file, choose, clock, block, form or Form())
    except _MonthFirst:  # of a later date than the first ones, perhaps: they are read again
        return _read(file, choose, clock, block, form or Form(), month_first=True)


def _read(file: Path, choose: Choose, clock: Clock | None, block: int, form: Form, *, month_first: bool = False) -> Log:
    lines = _lines(file, block)
    number, first = next(lines, (1, []))
    head = find_header(first[form.skip_rows :], form.columns)
    if head is None:
        raise InputError(file, "", "is empty", "a header row and numbers")
    _refuse_decimal_commas(file, head)
    boxed = clock is None and blackbox.is_blackbox(head.names)
    clock = blackbox.clock(head.names) if boxed else clock
    table = _Table(file, head, choose, clock, month_first)
    start = form.skip_rows + head.first
    table.take(number + start, first[start:])
    for number, some in lines:
        table.take(number, some)
    log = table_log(file, {"": table.columns()}, {"": table.header}, clock, table.warnings())
    parameters = blackbox.settings(head.before)
    about = " ".join(" ".join(row) for row in head.before if row and row[0].lower().startswith(("product", "firmware")))
    return replace(log, system=blackbox.SYSTEM if boxed else "", parameters=parameters, about=about)


def _refuse_decimal_commas(file: Path, head: Header) -> None:
    """Raise InputError where rows have up to twice as many fields as names, for decimal commas stand between commas."""
    named = max((len(row) for row in head.before if not any(map(is_number, row))), default=0)
    if head.names[0].isdigit() and (hint := _decimal_commas(head.mark, named, len(head.names))):
        raise InputError(file, "", f"has {named} names and {len(head.names)} fields in a row{hint}", MARKED)


MARKED = "points in numbers, or semicolons between fields"


def _decimal_commas(mark: str | None, names: int, fields: int) -> str:
    """What may be meant where a row has more fields than there are names; empty where it is not that."""
    return " (decimal commas between commas?)" if mark == "," and 1 < names < fields <= 2 * names else ""


def _lines(file: Path, size: int) -> Iterator[tuple[int, list[str]]]:
    """Whole lines by blocks, each with the number of its first line."""
    number, remainder = 1, b""
    with open_file(file, "a log") as stream:
        for data in _in_utf8(file, stream, size):
            whole, _, remainder = (remainder + data).rpartition(b"\n")
            if not whole and len(remainder) > size:
                raise InputError(file, f"line {number}", f"has over {size} bytes", "a row of numbers")
            lines = _text(file, whole).split("\n") if whole else []
            yield number, lines
            number += len(lines)
    if remainder.strip():
        yield number, [_text(file, remainder)]


def _in_utf8(file: Path, stream: BinaryIO, size: int) -> Iterator[bytes]:
    """Bytes of a file by blocks, in UTF-8, which may be UTF-16 by its first two bytes, with or without line feeds."""
    wide = stream.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    stream.seek(0)
    decoder = codecs.getincrementaldecoder("utf-16")()
    try:
        while data := stream.read(size):
            text = decoder.decode(data).encode() if wide else data
            yield text if b"\n" in text else text.replace(b"\r", b"\n")
    except UnicodeError as error:
        raise InputError(file, "", f"is not text in UTF-16 ({error})", "CSV with a header row") from None


def _text(file: Path, data: bytes) -> str:
    """Text in UTF-8, or, where it is none and has no byte that stands for no letter, in Latin-1."""
    try:
        text = data.decode("utf-8-sig").replace("\r", "")
        return text if text.isascii() else text.translate(PRINTED)
    except UnicodeDecodeError as error:
        if not CONTROLS.intersection(data):
            return data.decode("latin-1").replace("\r", "")
        raise InputError(file, "", f"is not text in UTF-8 ({error.reason})", "CSV with a header row") from None


class _MonthFirst(Exception):
    """A date of the file, as 2/29/2024, has its month first."""


class _Table:
    """The wanted columns as they come in."""

    def __init__(self, file: Path, head: Header, choose: Choose, clock: Clock | None, month_first: bool) -> None:
        self.file, self.mark, self.clock, self.month_first = file, head.mark, clock, month_first
        self.header = [name.strip().strip('"') for name in head.names]
        self.marks = len(self.header) - 1
        if len(self.header) > CHANNELS:
            raise InputError(file, "", f"has {len(self.header)} columns", f"at most {CHANNELS}")
        if twice := next((name for name in self.header if name and self.header.count(name) > 1), None):
            if is_number(twice):
                raise InputError(file, twice, "is no name", "a header row")
            raise InputError(file, twice, "is twice in the header", "each name once")
        wanted = {*choose("", self.header)}
        self.places = [i for i, name in enumerate(self.header) if name in wanted or is_clock("", name, clock)]
        self.parts: list[np.ndarray] = []
        self.cut = self.fields = 0
        self.words: list[int] = []
        self.dates = dict[str, str]()  # with the column that they are in

    def take(self, number: int, lines: Sequence[str]) -> None:
        """Take the lines that begin at this number."""
        if not self.places or not any(lines):
            return
        if self.cut:
            raise self._other_count(self.cut)
        if any("D" in line or "d" in line or (self.mark != "," and "," in line) for line in lines):
            lines = [line if line.startswith('"') else numeric(line, self.mark) for line in lines]
        try:
            if self.mark and any(line.count(self.mark) != self.marks and '"' not in line for line in lines if line):
                raise ValueError("another number of fields")
            options = {"delimiter": self.mark, "usecols": self.places, "comments": None, "quotechar": '"', "ndmin": 2}
            self.parts.append(np.loadtxt(lines, np.float64, **options))
        except ValueError:
            self.parts.append(np.array([*self._slowly(number, lines)]).reshape(-1, len(self.places)))

    def _slowly(self, first: int, lines: Sequence[str]) -> Iterator[list[float]]:
        """Line by line where something is no number: missing samples, a row of units, a cut end, or an error."""
        for number, line in enumerate(lines, first):
            fields = self._fields(number, line)
            if self.cut:
                raise self._other_count(self.cut)
            if not line.strip():
                continue
            if not any(map(is_number, fields)) and self._is_of_words(fields):
                self.words.append(number)
                continue
            if len(fields) != len(self.header):
                self.cut, self.fields = (
                    number,
                    len(fields),
                )  # an error, unless it is the last line, which a full card cuts
                continue
            yield [self._number(number, i, fields[i]) for i in self.places]

    def _is_of_words(self, fields: Sequence[str]) -> bool:
        """Whether a line without numbers is text: units below the names, the names once more, words after the end."""
        begins = not self.parts and not self.words
        return begins or len(fields) != len(self.header) or fields == [*self.header]

    def _fields(self, number: int, line: str) -> list[str]:
        quoted = csv.reader([line], delimiter=self.mark) if self.mark else iter([line.split()])
        try:
            return [field.strip() for field in next(quoted, [])]
        except csv.Error as error:
            raise InputError(self.file, f"line {number}", f"is no row ({error})", "a row of numbers") from None

    def _number(self, line: int, column: int, field: str) -> float:
        if field.lower() in MISSING:
            return np.nan
        try:
            return value_of(field)
        except ValueError:
            name = self.header[column]
            clock = is_clock("", name, self.clock)
            if clock and (moment := self._moment(name, field)) is not None:
                return moment / seconds_of(name, self.clock)
            wrong, dated = f"is '{field[:40]}' in line {line}", f", or a time as {AS_DATES}" if clock else ""
            raise InputError(self.file, name, wrong, f"a number, or nothing for a missing one{dated}") from None

    def _moment(self, name: str, field: str) -> float | None:
        """Seconds of a date and time. Raises _MonthFirst where only that order makes a date of it."""
        moment = time_of_day(field, self.month_first)
        if moment is None and not self.month_first and time_of_day(field, month_first=True) is not None:
            raise _MonthFirst
        if date := in_either_order(field):
            self.dates.setdefault(date, name)
        return moment

    def _refuse_either_order(self) -> None:
        """Raise InputError where dates are some with the day first and others with the month first."""
        orders = [[time_of_day(f"{date} 0:00", first) for date in self.dates] for first in (False, True)]
        by_day, by_month = np.diff(np.array(orders, np.float64))  # NaN where they are no dates
        if np.isnan(by_month - by_day).any() or np.array_equal(by_day, by_month):
            return
        (date, name), (other, _) = [*self.dates.items()][:2]
        wrong = f"is {date}, then {other}: day or month first?"
        raise InputError(self.file, name, wrong, "dates as 2024-02-29 23:59:50")

    def _other_count(self, line: int) -> InputError:
        hint = _decimal_commas(self.mark, len(self.header), self.fields)
        expected = MARKED if hint else f"{len(self.header)} as the header"
        return InputError(self.file, f"line {line}", f"has another number of fields{hint}", expected)

    def columns(self) -> dict[str, np.ndarray]:
        """All of each kept column. Raises InputError where dates may be read in two ways."""
        self._refuse_either_order()
        table = np.concatenate(self.parts) if self.parts else np.empty((0, len(self.places)))
        self.parts.clear()
        return {self.header[i]: table[:, at] for at, i in enumerate(self.places)}

    def warnings(self) -> list[str]:
        """Sentences on lines that were left out."""
        lines = ", ".join(map(str, self.words[:TOLD]))
        more = f" and {len(self.words) - TOLD} more" if len(self.words) > TOLD else ""
        several = f"lines {lines}{more} hold no numbers and were left out"
        one = f"line {lines} holds no numbers (units?) and was left out"
        sentences = [several if len(self.words) > 1 else one] if self.words else []
        return [*sentences, f"line {self.cut}, the last, is cut and was left out"] if self.cut else sentences
