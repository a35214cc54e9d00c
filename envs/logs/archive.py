"""Logs as NumPy archives (.npz)."""

from pathlib import Path
from typing import Any

import numpy as np

from envs.files import open_archive

_DIMENSIONS = {"t": 1, "odo": 2, "idx": 1, "ranges": 2, "ang0": 0, "dang": 0, "maxr": 0}
_OPTIONAL = {"mount_x": 0, "off": 0}


def read_archive(path: Path) -> dict[str, Any]:
    """Read the arrays of `load_log`, `off` added to `t`.

    Raises:
        ValueError: the file is damaged, or an array is missing or has another shape.
    """
    arrays: dict[str, Any] = {}
    name = ""
    try:
        with open_archive(path) as archive:
            if missing := _DIMENSIONS.keys() - set(archive.files):
                raise ValueError(f"lacks the arrays {sorted(missing)}")
            for name in (_DIMENSIONS | _OPTIONAL).keys() & set(archive.files):
                arrays[name] = archive[name]
    except PermissionError:
        raise
    except Exception as error:  # NumPy and zipfile raise many kinds; objects are scans with unequal numbers of beams
        said = " ".join(str(error).split())
        raise ValueError(f"{path}{f', array {name}' if name else ''}: {said}") from error
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray):
            raise ValueError(f"{path}, array {name}: damaged")
        dimensions = (_DIMENSIONS | _OPTIONAL)[name]
        if array.ndim != dimensions or array.dtype.kind not in "iuf":
            raise ValueError(
                f"{path}, array {name}: numbers in {dimensions} dimensions are needed, got {array.dtype} {array.shape}"
            )
    if not np.isfinite(arrays["idx"]).all():
        raise ValueError(f"{path}, array idx: must be finite")
    if arrays["odo"].shape[1] != 3:
        raise ValueError(f"{path}, array odo: rows of x, y, heading are needed, got shape {arrays['odo'].shape}")
    return arrays | {"t": arrays["t"] + float(arrays.get("off", 0.0))}
