"""Bad input, in one line (file, key, what is wrong, what was expected), lost ranks, what native code cannot; hints."""

import difflib
import functools
import logging
from collections.abc import Iterable
from pathlib import Path

from rotorid_torch.printable import printable


class InputError(ValueError):
    """Bad input; the commands turn it into one line on stderr and exit code 2. Its text is `printable`.

    Parameters
    ----------
    file : path of the file or folder that is at fault, or a word for what has no file ("arrays", "usage").
    key : channel, key or option inside it; empty where the whole file is meant.
    wrong : what is wrong, in plain words.
    expected : what was expected instead.
    """

    def __init__(self, file: str | Path, key: str, wrong: str, expected: str) -> None:
        self.file, self.key, self.wrong, self.expected = str(file), key, wrong, expected
        place = f"{self.file}: {key}" if key else self.file
        super().__init__(printable(" ".join(f"{place}: {wrong}; expected {expected}".split()), layout=False))


class WrappedAngle(UserWarning):
    """An output jumps by whole turns and is not declared an angle."""


class OutsideRange(UserWarning):
    """A free run leaves the range of the flights that its model was identified from."""


class LostRank(RuntimeError):
    """Another process of the run has ended or does not answer; exit code 1."""

    def __init__(self) -> None:
        super().__init__("a process of this run is lost; an earlier RUN is as it was; identify --resume goes on")


class ReportedElsewhere(Exception):
    """Another process of the run was the first to fail and tells why; this one, failed with `error`, says nothing."""

    def __init__(self, error: BaseException) -> None:
        self.error = error
        super().__init__(str(error))


class Unsupported(Exception):
    """A model that cannot become native code, or not on this machine; the text says why.

    Torch does the work, but where native code was asked for or nothing else can (filter error of a model, exports).
    """


@functools.cache
def say_once(text: str) -> None:
    """One line on the error stream, the first time in a process; nothing later."""
    logging.getLogger("rotorid_torch").warning(text)


def nearest(name: str, words: Iterable[str]) -> str:
    """Hint for a misspelt or shortened name, " (did you mean 'x'?)" or an empty string."""
    words = list(dict.fromkeys(words))
    ending = sorted(word for word in words if word.endswith(f".{name}"))
    lower = {word.lower(): word for word in words}
    match = ending[:3] or [lower[word] for word in difflib.get_close_matches(name.lower(), lower, n=1)]
    return f" (did you mean {' or '.join(map(repr, match))}?)" if match else ""
