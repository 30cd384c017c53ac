"""Records as tables of pandas, where it is installed."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from rotorid_torch.errors import InputError


def frame(columns: Mapping[str, Any], index: str | None = None) -> Any:
    """A DataFrame of columns by name, with one of them as index.

    Raises InputError: pandas is not installed.
    """
    try:
        pandas = import_module("pandas")
    except ImportError:
        raise InputError("to_pandas", "", "pandas is not installed", "pip install pandas") from None
    table = pandas.DataFrame(dict(columns))
    return table if index is None else table.set_index(index)
