"""Work on another device: what is made there, and dataclasses of tensors that are taken there."""

from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import torch
from torch import Tensor

Item = TypeVar("Item")


def working_on(device: str) -> AbstractContextManager[object]:
    """Inside, tensors that name no device are made on this one."""
    return nullcontext() if device == "cpu" else torch.device(device)


def moved(item: Item, device: str | torch.device) -> Item:
    """The item with its tensors on a device, those inside dataclasses, tuples, lists and dicts too."""
    return _moved(item, device)


def _moved(item: Any, device: str | torch.device) -> Any:
    if isinstance(item, Tensor):
        return item.to(device)
    if is_dataclass(item) and not isinstance(item, type):
        return replace(item, **{f.name: _moved(getattr(item, f.name), device) for f in fields(item) if f.init})
    if isinstance(item, tuple):
        parts = [_moved(part, device) for part in item]
        return type(item)(*parts) if hasattr(item, "_fields") else tuple(parts)
    if isinstance(item, list):
        return [_moved(part, device) for part in item]
    if isinstance(item, dict):
        return {key: _moved(part, device) for key, part in item.items()}
    return item
