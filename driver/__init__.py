"""A robot without a simulator. `Driver` is imported on first use: the process that sends commands needs little."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .driver import Driver as Driver

__all__ = ["Driver"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from .driver import Driver

    return Driver
