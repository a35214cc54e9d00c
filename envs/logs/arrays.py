"""Logs as NumPy arrays (.npz)."""

from pathlib import Path

import numpy as np

from .log import Log, ScanGeometry


def read_arrays(path: Path, max_range: float | None) -> Log:
    """Read a log from the arrays that `load_log` names."""
    with np.load(path) as arrays:
        if missing := {"t", "odo", "ranges", "idx", "ang0", "dang", "maxr"} - set(arrays):
            raise ValueError(f"{path}: lacks the arrays {sorted(missing)}")
        offset = float(arrays["off"]) if "off" in arrays else 0.0
        limit = min(float(arrays["maxr"]), np.inf if max_range is None else max_range)
        geometry = ScanGeometry(float(arrays["ang0"]), float(arrays["dang"]), limit)
        return Log.checked(path, arrays["t"] + offset, arrays["odo"], arrays["idx"], arrays["ranges"], geometry)
