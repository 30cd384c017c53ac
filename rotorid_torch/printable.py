"""Numbers in words, and text of a user's file: what would steer a terminal, a page or a log is a sign that is seen."""

import html
import math
import unicodedata
from collections.abc import Iterable, Sequence

_PICTURES = {number: chr(0x2400 + number) for number in range(0x20)} | {0x7F: "\u2421"}
"""Control characters of ASCII by the pictures that Unicode has of them: ESC is \u241b."""
_HIDDEN = frozenset(("Cc", "Cf", "Cs", "Zl", "Zp"))
"""Unicode's categories of controls, of format signs (they turn the direction of text), of half characters that no
encoding can write, and of separators of lines and paragraphs."""
LAYOUT = frozenset(map(ord, "\n\t"))


class _Signs(dict[int, str]):
    """What each character is shown as, found when it is first met."""

    def __missing__(self, number: int) -> str:
        hidden = unicodedata.category(chr(number)) in _HIDDEN
        self[number] = _PICTURES.get(number, "\ufffd") if hidden else chr(number)
        return self[number]


_LINE = _Signs()
_PAGE = _Signs({number: chr(number) for number in LAYOUT})


def printable(text: str, layout: bool = True) -> str:
    """Replace every character that a terminal would obey instead of showing it.

    layout : leave ends of lines and tabulators as they are; without, the text is one line.
    """
    return text.translate(_PAGE if layout else _LINE)


def significant(value: float, count: int = 1) -> str:
    """A number by its significant figures, without an exponent where people write none: "10" for an error of 12.3."""
    return f"{float(f'{value:.{count}g}'):g}"


def percent(share: float | None, digits: int = 0) -> str:
    """A share in per cent, a dash for none or no number; what is not all is not 100 %."""
    if share is None or not math.isfinite(share):
        return "–"
    rounded = f"{100.0 * share:.{digits}f} %"
    return f"{min(100.0 * share, 99.9):.1f} %" if rounded.startswith("100") and share < 1.0 else rounded


def html_table(title: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A paragraph and a table, for a notebook."""
    cells = "".join(f'<th scope="col">{html.escape(name)}</th>' for name in head)
    lines = ("".join(f"<td>{html.escape(str(cell))}</td>" for cell in row) for row in rows)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f"<p>{html.escape(title)}</p><table><thead><tr>{cells}</tr></thead><tbody>{body}</tbody></table>"
