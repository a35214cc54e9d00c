"""Shared arrays of vector environments, and storage of `info` in structured arrays."""

import ctypes
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

Extras = dict[int, dict[str, Any]]
"""Entries of `info` that structured arrays cannot hold, by sub-environment."""
WHOLE = ""


def parts_of(observation: Any) -> Mapping[str, Any]:
    """Return the arrays of an observation, or the spaces of an observation space, by name; "" names a single array."""
    if isinstance(observation, spaces.Dict):
        return observation.spaces
    return observation if isinstance(observation, dict) else {WHOLE: observation}


def whole_of(parts: Mapping[str, np.ndarray]) -> Any:
    """Return the observation with the given arrays by name: a dictionary, or a single array if its name is ""."""
    return parts[WHOLE] if WHOLE in parts else dict(parts)


class Arrays(NamedTuple):
    """Inputs and outputs of a vector environment as arrays, one row per sub-environment."""

    observations: dict[str, np.ndarray]
    actions: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray

    def rows(self, share: slice) -> "Arrays":
        observations = {name: array[share] for name, array in self.observations.items()}
        return Arrays(observations, *(array[share] for array in self[1:]))


class Memory:
    """Buffers of observations, actions, rewards and flags, shared between processes."""

    def __init__(self, num_envs: int, observations: spaces.Space, actions: spaces.Space, context: Any = None) -> None:
        parts = parts_of(observations)
        rows: list[tuple[Any, Any]] = [(space.shape, space.dtype) for space in (*parts.values(), actions)]
        if any(shape is None for shape, _ in rows):
            raise ValueError(f"observations must be one array, or a Dict of arrays, got {observations}")
        rows += [((), np.float64), ((), np.bool_), ((), np.bool_)]
        self._names = tuple(parts)
        self._layout = [((num_envs, *shape), np.dtype(kind)) for shape, kind in rows]
        sizes = [max(math.prod(shape) * dtype.itemsize, 1) for shape, dtype in self._layout]
        self._buffers = [bytearray(k) if context is None else context.RawArray(ctypes.c_uint8, k) for k in sizes]

    def arrays(self) -> Arrays:
        views = [
            np.frombuffer(buffer, dtype, math.prod(shape)).reshape(shape)
            for buffer, (shape, dtype) in zip(self._buffers, self._layout, strict=True)
        ]
        return Arrays(dict(zip(self._names, views, strict=False)), *views[len(self._names) :])


class Absent:
    """Marker of an entry that is missing in `info`."""


SCALARS: dict[type, str] = {kind: np.dtype(kind).str for kind in (float, bool, int, np.float64, np.float32, np.int64)}
"""NumPy type code, such as "<f8", of each scalar type that structured arrays of `info` store."""


def kind_of(value: Any) -> Any:
    """Return the NumPy type of an `info` value, or None if structured arrays cannot hold the value."""
    if (code := SCALARS.get(type(value))) is not None:
        return None if type(value) is int and not -(2**63) <= value < 2**63 else code
    if isinstance(value, dict):
        kinds = kinds_of(value)
        return kinds if kinds and len(kinds) == len(value) else None
    is_array = type(value) is np.ndarray and value.dtype.kind in "biufc"
    return (value.dtype.str, value.shape) if is_array else None


def kinds_of(info: Mapping[Any, Any]) -> list[tuple[str, Any]]:
    """Return name and NumPy type of each `info` entry that structured arrays can hold."""
    names = [name for name in info if type(name) is str and name != "final_obs" and name[:1] not in ("", "_")]
    return [(name, kind) for name in names if (kind := kind_of(info[name])) is not None]


class Records:
    """Storage of `info`: a structured array for entries with fixed types, and dictionaries for all other entries."""

    def __init__(self, num_envs: int, kinds: Sequence[tuple[str, Any]]) -> None:
        self.kinds, self.rows, self.extras = dict(kinds), np.zeros(num_envs, [*kinds]), Extras()

    def note(self, i: int, info: Mapping[str, Any], names: Iterable[str] | None = None) -> None:
        """Store entries of the `info` of sub-environment `i`. `names`: keys to store; None for all."""
        for name in dict.fromkeys([*self.kinds, *info]) if names is None else names:
            kind = self.kinds.get(name)
            if kind is not None and kind_of(info.get(name)) == kind:
                self.rows[name][i] = _to_record(info[name], kind)
            else:
                self.extras.setdefault(i, {})[name] = info.get(name, Absent)


def _to_record(value: Any, kind: Any) -> Any:
    return tuple(_to_record(value[name], one) for name, one in kind) if isinstance(kind, list) else value


def from_record(value: Any) -> Any:
    """Convert a value of a structured array to its original Python type."""
    if value.dtype.names:
        return {name: from_record(value[name]) for name in value.dtype.names}
    return value.item() if isinstance(value, np.bool_ | np.float64 | np.int64) else value
