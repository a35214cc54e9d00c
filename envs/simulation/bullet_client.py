"""PyBullet, imported late and silently, with a physics client of its own."""

import os
import weakref
from functools import partial
from types import ModuleType
from typing import Any


def import_pybullet() -> ModuleType:
    """Import PyBullet without the line that it prints on standard error.

    Raises:
        ImportError: it is not installed; the message says how to get it.
    """
    stderr, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        import pybullet
    except ImportError as error:
        raise ImportError(
            "physics='bullet' needs PyBullet, which has wheels for Linux x86_64 and Python 3.11 and older: "
            "install it there with `pip install pybullet`, or use physics='kinematic'"
        ) from error
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(null)
    return pybullet


class BulletClient:
    """A physics client: the functions of PyBullet without their argument `physicsClientId`, and its constants."""

    def __init__(self) -> None:
        self._module = import_pybullet()
        self._id = self._module.connect(self._module.DIRECT)
        self.close = weakref.finalize(self, self._module.disconnect, self._id)
        """Disconnects, when it is called or the client is collected; a second time does no harm."""

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._module, name)
        if callable(found):
            found = partial(found, physicsClientId=self._id)
        setattr(self, name, found)  # so that the next look-up does not come here
        return found
