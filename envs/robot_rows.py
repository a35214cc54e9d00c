"""Robots as kernels for observations see them: all at once, as rows of arrays."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba.typed import List

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.simulation.records import ROW


@njit(cache=True)
def repeat(item, count):
    """Return a Numba list that contains `item` `count` times."""
    items = List()
    for _ in range(count):
        items.append(item)
    return items


@njit(cache=True)
def put(items, i, item):
    """Set element `i` of a Numba list. Cached by Numba, unlike list methods."""
    items[i] = item


class RobotRows:
    """Records, scans and maps of identical robots, of one environment or of many. Contains ground truth."""

    task_arrays: Sequence[Any] | None = None
    """`Task.arrays` of many environments, as Numba lists; None for one environment, whose parts know the task."""

    surroundings: Any = None
    """Wall segments, circular obstacles, magnets and people of many environments, as a Numba list."""

    def __init__(
        self, robots: Sequence[Any], numbers: np.ndarray, ranges: np.ndarray, memory: Any, truths: Sequence[Any] = ()
    ) -> None:
        """Refer to `Robot` objects, to their arrays as in `Rows`, and to `GroundTruth` objects."""
        self.robots, self.numbers, self.ranges, self.memory = robots, numbers, ranges, memory
        self.truths, self.active = truths, np.ones(len(robots), dtype=np.bool_)
        """Ground truth for parts of users; mask of robots to write, shape (n,), bool."""
        self._levels: dict[float, tuple[list[Any], list[tuple[Any, Any]]]] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_levels": {}}  # Numba lists cannot be pickled

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, numbers=state["numbers"].view(ROW))  # as `Rows` do

    def levels(self, resolution: float) -> Sequence[Any]:
        """Return the maps of all robots, reduced to cells of about `resolution` [m], for cropping map images.

        Returns:
            Bit-packed maps (Numba list, or a tuple for one robot); their origins (x, y) and cell sizes [m], heights and
            widths [cells], shape (n, 5), float64.
        """
        robots = self.robots
        if resolution not in self._levels:
            words = robots[0].pyramid.level(resolution).words
            maps = repeat(words, len(robots)) if len(robots) > 1 else (words,)  # Numba reads tuples faster
            self._levels[resolution] = [maps, np.zeros((len(robots), 5))], [(None, None)] * len(robots)
        found, known = self._levels[resolution]
        for k, robot in enumerate(robots):
            revision, words = known[k]
            if robot.pyramid.revision is revision:
                continue
            level, grid = robot.pyramid.level(resolution), robot.belief.grid
            known[k] = robot.pyramid.revision, level.words
            if level.words is words:
                continue
            found[1][k] = *grid.origin, level.block * grid.resolution, level.height, level.width
            if len(robots) > 1:
                put(found[0], k, level.words)
            else:
                found[0] = (level.words,)
        return found
