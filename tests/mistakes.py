"""What tests of mistakes ask of a refusal: one line that names the argument, and nothing of torch or numpy in it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rotorid_torch.errors import InputError

RAW = (
    "Traceback",
    "mat1",
    "size mismatch",
    "must match the size",
    "NoneType",
    "vmap",
    "at index",
    "unhashable",
    "not subscriptable",
)
"""Words of torch, NumPy and Python that help nobody."""


def one_line(call: Callable[[], Any], key: str) -> str:
    """The refusal of a call; key : of it, and behind " | " words of the line."""
    with pytest.raises(InputError) as refused:
        call()
    line = str(refused.value)
    assert len(line.splitlines()) == 1
    assert len(line) < 400
    key, _, words = key.partition(" | ")
    assert key in f"{refused.value.file}: {refused.value.key}", line
    assert words in line, line
    assert refused.value.expected
    assert not any(word in line for word in RAW), line
    return line
