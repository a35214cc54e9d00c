"""Memory that the processes of a vector environment share, and the records that they send each other."""

import ctypes
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

Extras = dict[int, dict[str, Any]]
"""By sub-environment: what `info` holds only now and then, such as `end_reason`, `final_obs` and `final_info`."""
WHOLE = ""
"""Name of an observation that is no `Dict`."""


def parts_of(observation: Any) -> Mapping[str, Any]:
    """Return an observation, or its space, by the names of its parts."""
    if isinstance(observation, spaces.Dict):
        return observation.spaces
    return observation if isinstance(observation, dict) else {WHOLE: observation}


def whole_of(parts: Mapping[str, np.ndarray]) -> Any:
    """Return the observation that has these parts."""
    return parts[WHOLE] if WHOLE in parts else dict(parts)


class Arrays(NamedTuple):
    """What sub-environments read and write in place, one row each."""

    observations: dict[str, np.ndarray]
    """Shape (num_envs, ...) each."""
    actions: np.ndarray
    """Shape (num_envs, ...)."""
    rewards: np.ndarray
    """Shape (num_envs,), float64."""
    terminated: np.ndarray
    """Shape (num_envs,), bool."""
    truncated: np.ndarray
    """Shape (num_envs,), bool."""

    def rows(self, share: slice) -> "Arrays":
        """Return some of the rows."""
        observations = {name: array[share] for name, array in self.observations.items()}
        return Arrays(observations, *(array[share] for array in self[1:]))


class Memory:
    """Memory for the arrays of so many sub-environments, which processes may share: pickling does not copy it."""

    def __init__(self, num_envs: int, observations: spaces.Space, actions: spaces.Space, context: Any = None) -> None:
        """Take memory for observations and actions of these spaces, and for what a step returns.

        It is shared by processes of a `multiprocessing` context. ValueError if an observation is not made of arrays.
        """
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
        """Return the arrays, which show this memory."""
        views = [
            np.frombuffer(buffer, dtype, math.prod(shape)).reshape(shape)
            for buffer, (shape, dtype) in zip(self._buffers, self._layout, strict=True)
        ]
        return Arrays(dict(zip(self._names, views, strict=False)), *views[len(self._names) :])


def record_type(info: Mapping[str, Any]) -> np.dtype:
    """Return the type of records that hold an info dict: numbers, texts, arrays, and dicts of them."""
    fields: list[Any] = []
    for name, value in info.items():
        if isinstance(value, Mapping):
            fields.append((name, record_type(value)))
        elif isinstance(value, str):
            fields.append((name, "U32"))
        else:
            array = np.asarray(value)
            fields.append((name, array.dtype, array.shape))
    return np.dtype(fields)


def to_record(info: Mapping[str, Any], dtype: np.dtype) -> tuple[Any, ...]:
    """Return an info dict as what is assigned to a record."""
    values = ((name, info[name]) for name in dtype.names or ())
    return tuple(to_record(value, dtype[name]) if isinstance(value, dict) else value for name, value in values)
