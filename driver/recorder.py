"""A recording that cannot end a drive."""

import contextlib
import logging
from pathlib import Path
from typing import Any

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.wrappers.record_bag import BagRecorder

LOGGER = logging.getLogger(__name__)


class SafeRecorder:
    """Recorder of a drive as a bag, which ends with a warning when a message cannot be written, as on a full disk."""

    def __init__(self, env: LidarEnv, path: Path) -> None:
        """Start recording; errors as of `BagRecorder`."""
        self._env, self._recorder, self._error = env, BagRecorder(env, path), ""
        self._record, env.on_period = env.on_period, self._try

    def _try(self, commands: Any) -> None:
        try:
            self._record(commands)  # type: ignore[misc]
        except Exception as error:
            self._error = f"has ended early: {error}"
            LOGGER.warning("the recording %s", self._error)
            with contextlib.suppress(Exception):
                self._recorder.close()
            self._env.on_period = None

    def close(self) -> None:
        """Complete the bag; RuntimeError if it ended early."""
        if self._error:
            raise RuntimeError(self._error)
        self._recorder.close()
