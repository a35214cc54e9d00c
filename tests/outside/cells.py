"""Rows of the tables, and comparisons of arrays and plain data."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .environments import RefusedError, SkippedError
from .files import Files


class Cell(NamedTuple):
    """A file, a tool that reads or writes it, and the comparison with this package."""

    file: str
    tool: str
    compare: Callable[[Files], None]
    """Function that raises an AssertionError with the reason if the two disagree."""
    right: str = "equal"
    """Result if they agree."""
    symptom: str = ""
    """Part of the result that is expected instead, if they disagree by no fault of this package."""
    known: str = ""
    """Reason that is then printed; empty for that of `compare`."""

    def result(self, files: Files) -> tuple[str, bool]:
        """Return the result, and whether it is as expected."""
        try:
            self.compare(files)
            text = self.right
        except SkippedError as error:
            return f"skipped: {error}", True
        except RefusedError as error:
            text = f"refused: {error}"
        except AssertionError as error:
            text = f"differs: {error}"
        except Exception as error:  # any error of this package is a wrong answer to a valid file
            text = f"differs: {type(error).__name__}: {error}"
        is_right = self.symptom in text if self.symptom else text == self.right
        return f"{text.partition(':')[0]}: {self.known}" if is_right and self.known else text, is_right


def close(found: Any, wanted: Any, tolerance: float, what: str) -> None:
    """Raise an AssertionError if two arrays differ by more than an absolute tolerance."""
    found, wanted = (np.asarray(each, dtype=float) for each in (found, wanted))
    assert found.shape == wanted.shape, f"{what} of shape {found.shape}, not {wanted.shape}"
    gap = float(np.abs(found - wanted).max(initial=0.0))
    assert gap <= tolerance, f"{what} {gap:.3g} apart"


def same(found: Any, wanted: Any, where: str = "content") -> None:
    """Raise an AssertionError if plain data differ by more than the precision of float32, that of some fields."""
    if isinstance(wanted, (dict, list)) and isinstance(found, type(wanted)):
        one, other = (each if isinstance(each, dict) else dict(enumerate(each)) for each in (found, wanted))
        assert one.keys() == other.keys(), f"only one {where} has {sorted(one.keys() ^ other.keys())}"
        for name in other:
            same(one[name], other[name], f"{where}[{name}]")
    elif found != wanted:
        is_close = isinstance(wanted, float) and math.isclose(found, wanted, rel_tol=1e-7)
        assert is_close, f"{where} is {found}, not {wanted}"
