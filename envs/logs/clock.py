"""Clocks of logs."""

import numpy as np

MAX_CLOCK_JUMP = 1.0
"""Clocks may run back by this much [s]: that of the Intel Research Lab's log does, by 0.9 s."""


def find_jump_back(times: np.ndarray) -> int | None:
    """Return the first row at which a clock has run back by more than `MAX_CLOCK_JUMP`; None if there is none.

    Args:
        times: shape (n,), n at least 1 [s].
    """
    is_back = np.maximum.accumulate(times) - times > MAX_CLOCK_JUMP
    return int(is_back.argmax()) if is_back.any() else None
