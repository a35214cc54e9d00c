"""`info` of single sub-environments, from the arrays of a vector environment."""

from collections.abc import Mapping
from typing import Any

import numpy as np

_EXACT = np.dtype(np.float64), np.dtype(np.int64), np.dtype(np.bool_)


def infos_of(info: Mapping[str, Any], num_envs: int) -> list[dict[str, Any]]:
    """Return the `info` of each sub-environment, without those of ended episodes.

    `info`: arrays by key, with masks as `_key`.
    """
    infos: list[dict[str, Any]] = [{} for _ in range(num_envs)]
    for key, values in info.items():
        mask = info.get(f"_{key}")
        if mask is None or key in ("final_info", "final_obs"):
            continue
        if isinstance(values, Mapping):
            values = infos_of(values, num_envs)
        elif values.ndim == 1 and values.dtype in _EXACT:
            values = values.tolist()  # numbers of Python, as single environments have
        for one, value, is_set in zip(infos, values, mask.tolist(), strict=True):
            if is_set:
                one[key] = value
    return infos
