"""What callers hand to functions of the package, checked: one line says which argument, what is wrong, what to write.

Every check raises InputError with that line where the value is anything else than it says.

Arrays are declared by their shape ("T nu", "... T ny"): a letter stands for a size that the first array with it fixes.
Lists, tuples, NumPy arrays, tensors and tables of pandas are all taken as arrays, of whole or real numbers.
"""

from __future__ import annotations

import inspect
import math
import os
import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from difflib import get_close_matches
from numbers import Real
from operator import index
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from rotorid_torch.errors import InputError, nearest

Numbers = Tensor | np.ndarray | Sequence[Any]
"""What is taken as an array."""
LISTED = 12
"""Names that a message lists at most."""
BESIDE = 0.1
"""By which inputs are moved where a function is called once more: at zero much is zero that changes elsewhere."""
ASIDE = 1e-4
"""By which one input is moved to see whether a function follows it."""
MIXED = 1e-6
"""Of the largest value: by what a row alone may differ from the same row of a batch, by rounding."""
ROUNDING = 1e-9
"""Of the largest entry: what a covariance may be off symmetry, or a negative eigenvalue, by rounding."""


@dataclass(frozen=True)
class Argument:
    """One argument: the function, file or flight that it belongs to, and its name."""

    of: str
    key: str

    def wrong(self, wrong: str, expected: str) -> InputError:
        """The refusal of this argument."""
        return InputError(self.of, self.key, wrong, expected)

    def inside(self, key: str) -> Argument:
        """An entry of this argument."""
        return Argument(f"{self.of}: {self.key}", key)


@dataclass(frozen=True)
class Array:
    """Declaration of an array: its name and shape; whether NaN marks missing samples; whether it may be absent."""

    key: str
    shape: str
    missing: bool = False
    optional: bool = False


@dataclass
class Sizes:
    """Sizes by their letters, as far as arrays have fixed them, and which array did."""

    by_letter: dict[str, int] = field(default_factory=dict)
    fixed_by: dict[str, str] = field(default_factory=dict)

    def without(self, *letters: str) -> Sizes:
        """A copy in which these letters are not fixed."""
        left = {letter: size for letter, size in self.by_letter.items() if letter not in letters}
        return Sizes(left, dict(self.fixed_by))

    def words(self, shape: str) -> str:
        """A declared shape with the sizes that are fixed, and by what: "(300, nu), 300 as in time"."""
        letters = shape.split()
        parts = [str(self.by_letter.get(letter, letter)) for letter in letters]
        fixed = {letter: self.fixed_by[letter] for letter in letters if letter in self.fixed_by}
        origins = "".join(f", {self.by_letter[k]} as in {key}" for k, key in fixed.items() if k in self.by_letter)
        return f"({', '.join(parts)}{',' if len(parts) == 1 else ''}){origins}"

    def fits(self, shape: str, sizes: Sequence[int]) -> bool:
        """Whether an array of these sizes has the declared shape."""
        letters = shape.split()
        if letters[0] == "...":
            letters = letters[1:]
            sizes = sizes[max(len(sizes) - len(letters), 0) :]
        if len(sizes) != len(letters):
            return False
        wanted = (int(k) if k.isdigit() else self.by_letter.get(k) for k in letters)
        return all(size in (n, None) for size, n in zip(wanted, sizes, strict=True))

    def fix(self, shape: str, sizes: Sequence[int], key: str) -> None:
        """Fix the letters that the array `key` brings."""
        letters = [letter for letter in shape.split() if letter != "..."]
        for letter, size in zip(reversed(letters), reversed(sizes), strict=False):
            if not letter.isdigit() and letter not in self.by_letter:
                self.by_letter[letter], self.fixed_by[letter] = int(size), key


def listed(names: Iterable[str], most: int = LISTED) -> str:
    """Names for a message, the first ones of many."""
    names = list(names)
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def enumerated(nouns: Sequence[str], last: str = "and") -> str:
    """Words with commas, the last one after `last`."""
    return nouns[0] if len(nouns) == 1 else f"{', '.join(nouns[:-1])} {last} {nouns[-1]}" if nouns else ""


def described(value: Any) -> str:
    """A value for a message: what it is, shortened."""
    if value is None or isinstance(value, bool | int | float | str):
        text = repr(str(value) if isinstance(value, str) else value)
        return text if len(text) <= 60 else f"{text[:57]}..."
    if isinstance(value, type):
        return f"the class {value.__name__}, not an object of it"
    if isinstance(value, np.ndarray | Tensor):
        return f"an array of shape {tuple(value.shape)}"
    word = type(value).__name__
    return f"{'an' if word[0] in 'aeiouAEIOU' else 'a'} {word}"


def numbers(argument: Argument, value: Any, missing: bool = False) -> Tensor:
    """Any array of numbers in float64: lists, NumPy, tensors, pandas. `missing`: NaN is allowed.

    Raises InputError: None, text, complex numbers, rows of different lengths, infinity, NaN where none is allowed, or
    half precision.
    """
    expected = "an array of numbers" + (", NaN where one is missing" if missing else "")
    tensor = _tensor(argument, value, expected)
    if tensor.is_complex():
        raise argument.wrong("holds complex numbers", "real numbers")
    refuse_half(argument, tensor)
    tensor = tensor.detach().to(torch.float64)
    if bool(torch.isinf(tensor).any()):
        wish = "finite numbers" + (", NaN where one is missing" if missing else "")
        raise argument.wrong(f"holds infinity{_where(torch.isinf(tensor))}", wish)
    if not missing and bool(torch.isnan(tensor).any()):
        raise argument.wrong(f"holds NaN{_where(torch.isnan(tensor))}", "finite numbers")
    return tensor


def refuse_half(argument: Argument, tensor: Tensor) -> None:
    """Raise InputError for numbers of two bytes, which are off by up to 5e-4 of their size: more than sensors are."""
    if tensor.is_floating_point() and tensor.element_size() < 4:
        raise argument.wrong(f"holds numbers of {tensor.dtype}", "float64 or float32, converted before digits are lost")


def _where(marked: Tensor) -> str:
    """Place of the first marked entry, for a message."""
    place = marked.nonzero()[0].tolist()
    return f" at [{', '.join(map(str, place))}]" if place else ""


def _tensor(argument: Argument, value: Any, expected: str) -> Tensor:
    if isinstance(value, Tensor):
        return filled(argument, value)
    if value is None or isinstance(value, bool | str | bytes | Mapping | set | type) or callable(value):
        raise argument.wrong(f"is {described(value)}", expected)
    try:
        if isinstance(value, Sequence) and any(isinstance(entry, Tensor) for entry in value):
            return torch.stack([torch.as_tensor(entry).detach() for entry in value])
        array = numbers_of(value)
    except (ValueError, TypeError, RuntimeError):
        raise argument.wrong("has rows of different lengths, or entries that are no numbers", expected) from None
    except OverflowError:
        raise argument.wrong("holds a number beyond 1.8e308", expected) from None
    if array.dtype.kind not in "biufc":
        raise argument.wrong(f"holds {_foreign(array)}", expected + _AS_NUMBERS.get(array.dtype.kind, ""))
    plain = array.dtype.isnative and min(array.strides, default=0) >= 0 and array.flags.writeable
    return torch.as_tensor(array if plain else np.array(array, dtype=array.dtype.newbyteorder("="), order="C"))


def filled(argument: Argument, tensor: Tensor) -> Tensor:
    """A tensor that holds its numbers, one beside the other.

    Raises InputError: a sparse tensor, or one without numbers.
    """
    if tensor.layout != torch.strided:
        raise argument.wrong(f"is a {tensor.layout} tensor", "a dense one: .to_dense()")
    if tensor.is_meta and type(tensor) in (Tensor, torch.nn.Parameter):  # a class of its own may hold them inside
        raise argument.wrong("holds no numbers: it is on the device meta", "a tensor with numbers")
    return tensor


def numbers_of(value: Any) -> np.ndarray:
    """An array, its objects that are numbers as float64; NaN where it is masked, or pandas writes that one is missing.

    Raises ValueError: rows of different lengths. OverflowError: a whole number beyond all floats.
    """
    masked = isinstance(value, np.ma.MaskedArray) and value.mask is not np.ma.nomask
    array = np.where(value.mask, np.nan, value.data) if masked else np.asarray(value)
    if array.dtype.kind != "O":
        return array
    entries = [math.nan if type(entry).__name__ == "NAType" else entry for entry in array.flat]
    if not all(isinstance(entry, Real) and not isinstance(entry, bool) for entry in entries):
        return array
    return np.array(list(map(float, entries))).reshape(array.shape)


_AS_NUMBERS = {
    "M": ": (t - t[0]) / np.timedelta64(1, 's')",
    "m": ": t / np.timedelta64(1, 's')",
    "U": ": a.astype(float)",
}
"""What makes numbers of dates, of spans of time and of text, by NumPy's kinds."""


def _foreign(array: np.ndarray) -> str:
    """What an array holds that is no number."""
    for entry in array.flat:
        if not isinstance(entry, int | float | np.number):
            return described(entry)
    return f"values of type {array.dtype}"


def shaped(argument: Argument, value: Any, shape: str, sizes: Sizes, missing: bool = False) -> Tensor:
    """Numbers of a declared shape; letters that are not yet fixed are fixed by it.

    Raises InputError: as `numbers`, or another shape.
    """
    if value is None:
        raise argument.wrong("is None", f"an array {sizes.words(shape)}")
    tensor = numbers(argument, value, missing)
    if not sizes.fits(shape, tensor.shape):
        raise argument.wrong(f"has shape {tuple(tensor.shape)}", sizes.words(shape) + _repair(tensor, shape, sizes))
    sizes.fix(shape, tensor.shape, argument.key)
    return tensor


def _repair(tensor: Tensor, shape: str, sizes: Sizes) -> str:
    """What may lead to the declared shape."""
    if tensor.dim() >= 2 and sizes.fits(shape, tensor.mT.shape):
        return "; is it transposed? np.stack(columns, axis=-1) puts columns beside each other"
    letters = [letter for letter in shape.split() if letter != "..."]
    if len(letters) == 1 and tensor.dim() > 1 and tensor.numel() in tensor.shape[:1]:
        return ": write a[:, 0]"
    if len(letters) == 1 and tensor.dim() == 0:
        return ": write [a]"
    if len(letters) == 2 and tensor.dim() < 2:
        if letters[0] == letters[1]:
            size = letters[0] if letters[0].isdigit() else sizes.by_letter.get(letters[0], letters[0])
            single = ": write [[a]]" if str(size) == "1" else f": a * np.eye({size})"
            return single if tensor.dim() == 0 else ": np.diag(a) makes one of variances"
        if tensor.dim() == 1 and sizes.fits(shape, (len(tensor), 1)):
            return ": write a[:, None] for a single column"
    return ""


def arrays(of: str, table: Sequence[Array], mapping: Any, sizes: Sizes) -> dict[str, Tensor]:
    """The arrays of a mapping, as a table declares them.

    Raises InputError: no mapping, an array that is absent (with the nearest name that is there), one that does not
    fit, or an entry of another name.
    """
    if not isinstance(mapping, Mapping):
        keys = listed(array.key for array in table)
        raise InputError(of, "", f"is {described(mapping)}", f"a dict with {keys}")
    keys = {array.key for array in table}
    foreign = [str(key) for key in mapping if key not in keys]
    taken = {}
    for array in table:
        argument = Argument(of, array.key)
        if mapping.get(array.key) is not None:
            taken[array.key] = shaped(argument, mapping[array.key], array.shape, sizes, array.missing)
            continue
        near = get_close_matches(array.key.lower(), [key.lower() for key in foreign], n=1)
        if near or not array.optional:
            what = "is None" if array.key in mapping else "absent"
            hint = f"; there is '{next(k for k in foreign if k.lower() == near[0])}'" if near else ""
            raise argument.wrong(f"{what}{hint}", f"an array {sizes.words(array.shape)}")
    if foreign:
        raise InputError(of, foreign[0], "unknown key, which nothing would read", f"one of {listed(sorted(keys))}")
    return taken


def number(
    argument: Argument,
    value: Any,
    what: str = "",
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    whole: bool = False,
) -> float:
    """One real (or whole) number; `what` it is, for the message.

    Raises InputError: an array, text, None, NaN or infinity, or a number that is too small.
    """
    noun = "a whole number" if whole else "a number"
    limit = f" above {above:g}" if above > -math.inf else f", at least {least:g}" if least > -math.inf else ""
    limit += f": {what}" if what else ""
    single = None
    if not isinstance(value, bool | str | bytes | complex) and value is not None:
        with suppress(TypeError, ValueError, RuntimeError):
            single = float(value)
    if single is None:
        raise argument.wrong(f"is {described(value)}", f"{noun}{limit}")
    if not (math.isfinite(single) and single > above and single >= least) or (whole and single != round(single)):
        raise argument.wrong(f"is {single:g}", f"{noun}{limit}")
    return single


def seed(argument: Argument, value: Any) -> int:
    """A seed as the command line takes it, of any type of whole numbers. Raises InputError: anything else."""
    whole = -1
    if not (isinstance(value, bool) or (isinstance(value, Tensor) and value.dtype == torch.bool)):
        with suppress(TypeError):
            whole = index(value)
    if 0 <= whole < 10**18:
        return whole
    raise argument.wrong(f"is {described(value)}", "a whole number from 0 on, of 18 digits at most: int(...)")


def word(argument: Argument, value: Any, allowed: Sequence[str], other: str = "") -> str:
    """One of some words; `other` is what else might have been given.

    Raises InputError: anything else, with the nearest word.
    """
    if isinstance(value, str) and value in allowed:
        return value
    hint = nearest(value, allowed) if isinstance(value, str) else ""
    raise argument.wrong(f"is {described(value)}{hint}", " or ".join(f'"{a}"' for a in allowed) + other)


def is_word(value: Any) -> bool:
    """Whether a value that may be a word or an array is none of numbers."""
    return value is None or isinstance(value, bool | str | bytes | Mapping)


def flag(argument: Argument, value: Any) -> bool:
    """True or False."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    raise argument.wrong(f"is {described(value)}", "True or False")


def instance(argument: Argument, value: Any, kind: type | tuple[type, ...], expected: str) -> Any:
    """An object of a class."""
    if isinstance(value, kind):
        return value
    raise argument.wrong(f"is {described(value)}", expected)


def optional(check: Callable[[Argument, Any], Any]) -> Callable[[Argument, Any], Any]:
    """The same check, with None let through."""
    return lambda argument, value: None if value is None else check(argument, value)


def place(argument: Argument, value: Any) -> Path:
    """A path of a file or folder.

    Raises InputError: no text and no path.
    """
    if isinstance(value, str | os.PathLike) and isinstance(os.fspath(value), str) and os.fspath(value):
        return Path(value)
    raise argument.wrong(f"is {described(value)}", "a path: text, or a pathlib.Path")


def sequence(argument: Argument, value: Any, expected: str) -> list[Any]:
    """A list or tuple (or any iterable that is no mapping and no text) as a list; a set, which has no order, sorted."""
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable) or isinstance(value, Tensor):
        raise argument.wrong(f"is {described(value)}", expected)
    return sorted(value, key=str) if isinstance(value, set | frozenset) else list(value)


def names(argument: Argument, value: Any, allowed: Sequence[str], noun: str) -> tuple[str, ...]:
    """A list of names that exist, each once.

    Raises InputError: a single word, a name that there is not (with the nearest one), or one that is given twice.
    """
    chosen = sequence(argument, value, f'a list of names of {noun}s: ["..."]')
    names_there = listed(dict.fromkeys(allowed)) or "none"
    for name in chosen:
        if not isinstance(name, str):
            raise argument.wrong(f"holds {described(name)}", f"names in quotes, of {names_there}")
        if name not in allowed:
            raise argument.wrong(f"there is no {noun} {name!r}{nearest(name, allowed)}", f"one of {names_there}")
    twice = sorted({name for name in chosen if chosen.count(name) > 1})
    if twice:
        raise argument.wrong(f"{twice[0]!r} is given twice", f"each {noun} once")
    return tuple(chosen)


def covariance(argument: Argument, value: Any, shape: str, sizes: Sizes, definite: bool = False) -> Tensor:
    """A covariance [..., n, n]: symmetric, no eigenvalue below zero; `definite`: none that is zero."""
    matrix = shaped(argument, value, shape, sizes)
    n = matrix.shape[-1]
    if matrix.shape[-2] != n:
        raise argument.wrong(f"has shape {tuple(matrix.shape)}", f"({n}, {n})")
    size = float(matrix.diagonal(dim1=-2, dim2=-1).abs().max()) if n else 0.0
    if n and float((matrix - matrix.mT).abs().max()) > ROUNDING * size:
        raise argument.wrong("is not symmetric", "a covariance")
    lowest = float(torch.linalg.eigvalsh(matrix).min()) if n else 1.0
    if lowest < -ROUNDING * size or (definite and lowest <= 0.0):
        wanted = "a covariance" + (", positive definite" if definite else "")
        raise argument.wrong(f"has eigenvalue {lowest:.3g}", wanted)
    return matrix


def evaluated(
    argument: Argument, function: Callable[..., Any], inputs: Sequence[Tensor], wanted: Sequence[int], form: str
) -> Tensor:
    """What a caller's function gives at some inputs, which ask for derivatives: it must stay within torch.

    wanted : shape of the result. form : how the function is to be written, "f(x, u) -> dx/dt".

    Raises InputError: it takes other arguments, fails, leaves torch, gives another shape, or other numbers each time.
    """
    refuse_signature(argument, function, len(inputs), form)
    watched, held = [value.detach().clone().requires_grad_() for value in inputs], _held_by(function)
    try:
        with torch.enable_grad(), warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Converting a tensor with requires_grad")  # it is refused below
            result = function(*watched)
    except InputError:
        raise
    except Exception as error:
        raise argument.wrong(*_failure(error, form, inputs)) from error
    if not isinstance(result, Tensor):
        kind = "a NumPy array" if isinstance(result, np.ndarray) else described(result)
        raise argument.wrong(f"returns {kind}", f"a tensor: {form}, with torch.stack([...], dim=-1) for several rows")
    if tuple(result.shape) != tuple(wanted):
        shapes = f"returns shape {tuple(result.shape)} for {_shapes(inputs)}"
        raise argument.wrong(shapes, f"shape {tuple(wanted)}; {form}{_reshaping(result, wanted, inputs)}")
    if result.is_complex():
        raise argument.wrong("returns complex numbers", f"real numbers; {form}")
    if result.dtype != inputs[0].dtype:
        wish = "float64 as the inputs are, without .half(), .float(), .long() or a comparison"
        raise argument.wrong(f"returns numbers of {result.dtype}", f"{wish}; {form}")
    if result.device != inputs[0].device:
        raise argument.wrong(f"returns numbers on the device {result.device}", f"{inputs[0].device}; {form}")
    _refuse_changing(argument, function, inputs, held)
    _refuse_mixing(argument, function, inputs)
    _refuse_plain(argument, function, dict(zip(_names_in(form), watched, strict=True)), result)
    if branches(function, inputs):
        raise argument.wrong(*ONE_NUMBER)
    return result.detach()


def _names_in(form: str) -> list[str]:
    """The inputs' names in the form of a function, "f(x, u) -> dx/dt"."""
    return form.partition("(")[2].partition(")")[0].split(", ")


def _held_by(function: Callable[..., Any]) -> dict[str, Tensor]:
    """Copies of the parameters and buffers of the module that a function belongs to, by name."""
    owner: Any = getattr(function, "__self__", function)
    tensors = (*owner.named_parameters(), *owner.named_buffers()) if isinstance(owner, torch.nn.Module) else ()
    return {name: tensor.detach().clone() for name, tensor in tensors}


def _shapes(inputs: Sequence[Tensor]) -> str:
    return ", ".join(str(tuple(value.shape)) for value in inputs)


def _reshaping(result: Tensor, wanted: Sequence[int], inputs: Sequence[Tensor]) -> str:
    """What may lead to the wanted shape."""
    if result.dim() > 1 and tuple(result.mT.shape) == tuple(wanted):
        return ": torch.stack([...], dim=-1) puts rows beside each other"
    if inputs[0].dim() == 1 and tuple(result.shape) == 2 * tuple(inputs[0].shape):
        return ": t has one dimension less than x; t[..., None] goes with x"
    if tuple(result.shape) in (tuple(wanted[:-1]), (*wanted, 1)):
        return ": keep one last dimension, as x[..., :1] or torch.stack([...], dim=-1)"
    return "" if result.shape[:-1] == torch.Size(wanted[:-1]) else ": write x[..., 0], not x[0]"


def _refuse_changing(
    argument: Argument, function: Callable[..., Any], inputs: Sequence[Tensor], held: dict[str, Tensor]
) -> None:
    """A function whose values, or what its module `held` before the first call, are others at each call."""
    values, drawn = list[Tensor](), torch.get_rng_state()
    points = [value.detach() + k * BESIDE for k, value in enumerate(inputs, 1)]  # states and controls cancel nowhere
    with torch.no_grad(), suppress(Exception):  # beside the start a function need not hold
        values = [function(*(point.clone() for point in points)).nan_to_num() for _ in range(2)]
    changed = [f"changes {name}" for name, now in _held_by(function).items() if not torch.equal(now, held[name])]
    if values and not torch.equal(*values):
        changed.append("gives other numbers")
    if not torch.equal(torch.get_rng_state(), drawn):  # two calls may be alike by chance
        changed.append("draws random numbers")
    if changed:
        same = "the same for the same inputs: no random numbers, and model.eval() for dropout and batch norm"
        raise argument.wrong(f"{changed[0]} at each call", same)


@torch.no_grad()
def _refuse_plain(
    argument: Argument, function: Callable[..., Any], watched: Mapping[str, Tensor], result: Tensor
) -> None:
    """A function that follows states or controls without a derivative; one that jumps, as a look-up, has none."""
    reached = [None] * len(watched)
    if result.requires_grad:
        ones = torch.ones_like(result)
        reached = torch.autograd.grad(result, list(watched.values()), ones, allow_unused=True)
    for name, grad in zip(watched, reached, strict=True):
        if grad is not None or name == "t":  # nothing is differentiated by time
            continue
        values = list[Tensor]()
        with suppress(Exception):  # beside the start a function need not hold
            values = [
                function(*(value + share * (key == name) for key, value in watched.items())).nan_to_num()
                for share in (ASIDE, 2.0 * ASIDE)
            ]
        if values and not torch.equal(*values):
            wish = "the tensor: no float(), .item(), .detach(), torch.tensor(), torch.no_grad() or NumPy"
            raise argument.wrong(f"uses {name} as plain numbers, and has no derivative by it", wish)


@torch.no_grad()
def _refuse_mixing(argument: Argument, function: Callable[..., Any], inputs: Sequence[Tensor]) -> None:
    """A function of which a row of a batch [n, ...] depends on the other rows, as with a norm or a mean of all."""
    share = torch.linspace(0.0, 1.0, len(inputs[0]) + 1).to(inputs[0])[1:]
    points = [value.detach() + BESIDE * share.view(-1, *[1] * (value.dim() - 1)) for value in inputs]
    apart = False
    with suppress(Exception):  # beside the start a function need not hold
        whole = function(*points)
        alone = torch.cat([function(*(value[k : k + 1] for value in points)) for k in range(len(share))])
        apart = not torch.allclose(alone, whole, MIXED, MIXED * float(whole.nan_to_num().abs().max()), equal_nan=True)
    if apart:
        wish = "each row by itself: dim=-1 in norms, means, sums and softmax"
        raise argument.wrong("gives a row of a batch other numbers than the same row alone", wish)


ONE_NUMBER = "asks a batch for one number, as if, float() and .item() do", "torch.where(condition, a, b) for if"


@torch.no_grad()
def branches(function: Callable[..., Any], inputs: Sequence[Tensor]) -> bool:
    """Whether a function asks a batch [n, ...] for one number, by which all rows then go."""
    try:
        with warnings.catch_warnings(action="ignore"):  # of operations that it does one by one
            torch.func.vmap(function)(*(value.detach() for value in inputs))
    except Exception as error:  # others say what vmap cannot do, which nobody asks for
        return any(words in str(error) for words in ("data-dependent control flow", ".item() on a Tensor"))
    return False


def refuse_signature(argument: Argument, function: Any, count: int, form: str) -> None:
    """What cannot be called with so many arguments in order.

    Raises InputError: no function, a class, or other arguments.
    """
    if isinstance(function, type):
        raise argument.wrong(f"is {described(function)}", f"a function {form}: {function.__name__}()")
    if not callable(function):
        raise argument.wrong(f"is {described(function)}", f"a function {form}")
    try:
        signature = inspect.signature(function.forward if isinstance(function, torch.nn.Module) else function)
    except (TypeError, ValueError):
        return
    try:
        signature.bind(*range(count))
    except TypeError:
        raise argument.wrong(f"takes {signature}", form) from None
    names, wanted = list(signature.parameters)[:count], _names_in(form)
    if names != wanted and sorted(names) == sorted(wanted):
        raise argument.wrong(f"takes {signature}", f"this order: {form}")


_TRANSLATED = (
    (r"mat1 and mat2 shapes cannot be multiplied \((.+) and (.+)\)", "a product of matrices {0} and {1}"),
    (r"size of tensor a \((\d+)\) must match the size of tensor b \((\d+)\)", "{0} and {1} entries do not go together"),
    (r"index (\d+) is out of bounds for dimension -?\d+ with size (\d+)", "there is no entry {0} of {1}"),
    (r"too many indices for tensor of dimension (\d+)", "more indices than its {0} dimensions"),
    (r"stack expects each tensor to be equal size, but got (\[.*?\]).* and (\[.*?\])", "shapes {0} and {1} stacked"),
)
"""What torch says of shapes, in words."""


def in_words(said: str) -> str:
    """What torch says of shapes, in words; empty where it says something else."""
    for pattern, words in _TRANSLATED:
        if matched := re.search(pattern, said):
            return words.format(*matched.groups())
    return ""


def _failure(error: Exception, form: str, inputs: Sequence[Tensor]) -> tuple[str, str]:
    """What to say of a function that has failed at some inputs, and what was expected."""
    text = (str(error).splitlines() or [""])[0]
    if words := in_words(text):
        wish = "x @ A.mT for A @ x" if words.startswith("a product") else "write x[..., 0], not x[0]"
        return f"fails: {words}, for inputs of shapes {_shapes(inputs)}", f"{form} for batches: {wish}"
    if said := advice(text):
        return said[0], f"{said[1]}; {form}"
    return f"fails: {type(error).__name__}: {text[:160]}", form


_ADVICE = (
    (("in-place operation",), "changes its inputs in place", "new tensors: a * x for x.mul_(a)"),
    (
        ("same dtype", "expected scalar type"),
        "mixes float32 and float64",
        "float64 throughout: register_buffer for tensors of a module, .double() of a network, x.new_tensor(...)",
    ),
    (("boolean value of tensor",), "branches on a tensor", "torch.where(condition, a, b) for if"),
    (
        ("converted to python scalars", "converted to a scalar"),
        "makes a plain number of a tensor",
        "torch functions: torch.sin for math.sin, no float()",
    ),
    (
        ("uninitialized parameter",),
        "has parameters without a shape",
        "a model of torch's lazy modules that was called once",
    ),
    (
        ("numpy", "data pointer"),
        "uses NumPy, which knows no derivatives",
        "torch functions: torch.sin for np.sin, torch.as_tensor(A) for arrays",
    ),
    (
        ("d input (got",),
        "holds a module for batches of one shape, as batch norm",
        "modules for any leading dimensions: nn.LayerNorm",
    ),
    (("random operation",), "draws random numbers", "the same for the same inputs"),
)
"""Words of torch, in small letters, what they mean, and what to write."""


def advice(text: str) -> tuple[str, str] | None:
    """What torch says of a function, in words, and what was expected; None where it says something else."""
    lower = text.lower()
    return next(((wrong, wish) for words, wrong, wish in _ADVICE if any(word in lower for word in words)), None)
