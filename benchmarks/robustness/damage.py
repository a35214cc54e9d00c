"""Random damage to valid files."""

import copy
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

EDGES = (0, -1, 1, 0.5, 1e5, 1e308, -1e308, 1e-320, -0.0, math.inf, -math.inf, math.nan, 2**31, 2**63, 10**30)
"""Numbers that programs forget."""
OTHERS = (None, True, "", "x", "\x00", "../..", "9" * 5000, [], {}, [[]], {"a": {}}, "1e999", "module:attribute")
"""Values of other types."""
DEPTH = 2000
"""Levels of nesting that are wrapped around a value."""
TYPES = (np.int8, np.complex64, np.bool_, np.float16, "U8")
"""Of arrays that should hold numbers of 64 bits."""


def damage_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """Return content with one to four damages: cut, bits flipped, bytes overwritten, inserted or repeated."""
    damaged = bytearray(content)
    for _ in range(rng.integers(1, 5)):
        at = int(rng.integers(len(damaged) + 1))
        kind = rng.integers(5)
        if kind == 0:
            del damaged[at:]
        elif kind == 1 and at < len(damaged):
            damaged[at] ^= 1 << int(rng.integers(8))
        elif kind in (2, 3):
            some = rng.bytes(int(rng.integers(1, 17)))
            damaged[at : at + len(some) * (kind == 2)] = some
        elif kind == 4:
            damaged[at:at] = damaged[at : at + int(rng.integers(1, 200))]
    return bytes(damaged)


def damage_tree(tree: Any, rng: np.random.Generator) -> Any:
    """Return nested mappings and lists with one to three damages of `DAMAGES`."""
    damaged = copy.deepcopy(tree)
    for _ in range(rng.integers(1, 4)):
        slots = list(_slots(damaged))
        if not slots:
            break
        holder, key = slots[rng.integers(len(slots))]
        DAMAGES[rng.integers(len(DAMAGES))](holder, key, rng)
    return damaged


def damage_array(array: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return an array with an element replaced, an axis cut or added, or of another type."""
    damaged = np.array(array, dtype=np.float64)
    kind = rng.integers(5)
    with np.errstate(all="ignore"):
        if kind <= 1 and damaged.size:
            damaged.flat[rng.integers(damaged.size)] = float(EDGES[rng.integers(len(EDGES))])
        elif kind == 2 and damaged.ndim:
            damaged = damaged[: rng.integers(len(damaged) + 1)]
        elif kind == 3:
            damaged = damaged[..., None] if rng.integers(2) else damaged.ravel()
        elif kind == 4:
            damaged = damaged.astype(TYPES[rng.integers(len(TYPES))])
    return damaged


def _slots(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every mapping or list of a tree with each of its keys or indices."""
    for key in list(tree) if isinstance(tree, dict) else range(len(tree)):
        yield tree, key
        if isinstance(tree[key], dict | list):
            yield from _slots(tree[key])


def _draw(values: tuple[Any, ...]) -> Callable[[Any, Any, np.random.Generator], None]:
    """Return what replaces a value by one of `values`."""
    return lambda holder, key, rng: holder.__setitem__(key, copy.deepcopy(values[rng.integers(len(values))]))


def _scale(holder: Any, key: Any, rng: np.random.Generator) -> None:
    if isinstance(holder[key], int | float):
        holder[key] = holder[key] * float(10.0 ** rng.integers(-9, 10))


def _rename(holder: Any, key: Any, rng: np.random.Generator) -> None:
    if isinstance(holder, dict):
        holder[f"{key}s"] = holder.pop(key)


def _repeat(holder: Any, key: Any, rng: np.random.Generator) -> None:
    if isinstance(holder[key], list):
        holder[key] = holder[key] * int(rng.integers(2, 40))
    elif isinstance(holder, list):
        holder.append(copy.deepcopy(holder[key]))


def _nest(holder: Any, key: Any, rng: np.random.Generator) -> None:
    for _ in range(rng.integers(1, 4)):
        holder[key] = [holder[key]]


DAMAGES: tuple[Callable[[Any, Any, np.random.Generator], None], ...] = (
    _draw(EDGES), _draw(EDGES), _scale, _scale, lambda holder, key, rng: holder.pop(key), _rename, _draw(OTHERS),
    _repeat, _nest,
)  # fmt: skip
"""What is done to a value of a mapping or a list, those that are there twice twice as often."""
