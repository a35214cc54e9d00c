"""Environment wrappers."""

from .record_bag import BagRecorder, RecordBag

__all__ = ["BagRecorder", "RecordBag"]
