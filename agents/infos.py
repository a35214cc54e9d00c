"""`info` of single sub-environments, from the arrays of a vector environment."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

TRUNCATED = "TimeLimit.truncated"
"""Key of stable-baselines3: whether a limit ended the episode, and not the task."""
_RUNNING = {TRUNCATED: False}  # extensions in C may take an empty dictionary for one without entries
_ABSENT: Any = object()
_EXACT = np.dtype(np.float64), np.dtype(np.int64), np.dtype(np.bool_)


def _entry(info: Mapping[str, Any], key: Any, i: int) -> Any:
    mask = info.get(f"_{key}")
    if mask is None or not mask[i] or key in ("final_info", "final_obs"):
        return _ABSENT
    values = info[key]
    value = info_of(values, i) if isinstance(values, Mapping) else values[i]
    return value.item() if isinstance(value, np.generic) and value.dtype in _EXACT else value


def info_of(info: Mapping[str, Any], i: int) -> dict[str, Any]:
    """Return the `info` of sub-environment `i`. `info`: arrays by key, with masks as `_key`."""
    entries = ((key, _entry(info, key, i)) for key in info)
    return {key: value for key, value in entries if value is not _ABSENT}


class LazyInfo(dict[str, Any]):
    """`info` in the middle of an episode. Only methods that need all keys fill the dictionary."""

    __slots__ = ("_i", "_info")
    _info: Mapping[str, Any] | None
    _i: int

    def get(self, key: Any, default: Any = None) -> Any:
        if self._info is None or key == TRUNCATED:
            return dict.get(self, key, default)
        value = _entry(self._info, key, self._i)
        return default if value is _ABSENT else value

    def __missing__(self, key: str) -> Any:
        if (value := self.get(key, _ABSENT)) is _ABSENT:
            raise KeyError(key)
        return value

    def __contains__(self, key: object) -> bool:
        return self.get(key, _ABSENT) is not _ABSENT

    def __reduce__(self) -> Any:
        return dict, (dict(self),)


def lazy_infos(info: Mapping[str, Any], num_envs: int) -> list[dict[str, Any]]:
    """Return the `info` of each sub-environment, as if no episode had ended; several times faster than `info_of`."""
    infos = [LazyInfo(_RUNNING) for _ in range(num_envs)]
    for i, one in enumerate(infos):
        one._info, one._i = info, i
    return infos  # type: ignore[return-value]


def _filled(method: Callable[..., Any]) -> Callable[..., Any]:
    def call(self: LazyInfo, *args: Any, **kwargs: Any) -> Any:
        if (info := self._info) is not None:
            self._info = None
            dict.update(self, info_of(info, self._i))
        return method(self, *args, **kwargs)

    return call


for _name in (
    *("__delitem__", "__eq__", "__ior__", "__iter__", "__len__", "__ne__", "__or__", "__repr__", "__reversed__"),
    *("__ror__", "__setitem__", "clear", "copy", "items", "keys", "pop", "popitem", "setdefault", "update", "values"),
):
    setattr(LazyInfo, _name, _filled(getattr(dict, _name)))
