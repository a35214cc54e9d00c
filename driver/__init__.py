from .driver import Driver

__all__ = ["Driver"]
