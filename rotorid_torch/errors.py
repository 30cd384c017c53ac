"""The one error that a user causes: bad input, told in one line (file, key, what is wrong, what was expected)."""

from __future__ import annotations

from pathlib import Path


class InputError(ValueError):
    """Bad input; the commands turn it into one line on stderr and exit code 2.

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
        super().__init__(" ".join(f"{place}: {wrong}; expected {expected}".split()))
