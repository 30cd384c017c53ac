"""The console that the commands print to: what a user's file says is shown on it and never obeyed."""

from collections.abc import Iterable
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from rotorid_torch.core.storage.atomic import OUTPUT, writing
from rotorid_torch.printable import printable


class PlainConsole(Console):
    """A console without markup, emoji and highlighting; control characters in what is printed are made visible.

    The styles and cursor movements of rich itself are no text and stay.
    """

    def __init__(self) -> None:
        super().__init__(soft_wrap=True, markup=False, emoji=False, highlight=False)

    def print(self, *objects: Any, **how: Any) -> None:
        """As rich does. Raises Unwritable where nothing can be printed."""
        with writing(OUTPUT):
            super().print(*objects, **how)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Segments of what is printed, their text made `printable`."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(printable(segment.text), segment.style)
