"""The true map beside the estimated one."""

import numpy as np

from envs.geometry import OCCUPIED, OccupancyGrid, Pose2D


class TrueMap:
    """The true walls in the map frame, to complete an estimated map with."""

    def __init__(self, walls: OccupancyGrid, start: Pose2D) -> None:
        """Take the true map, world frame, and the pose of the map frame's origin in it."""
        self._walls, self._start = walls, start
        self._grid: OccupancyGrid | None = None

    def complete(self, grid: OccupancyGrid) -> OccupancyGrid:
        """Return the estimated map with the true one where it is unknown; its extent is that of the true one."""
        truth = self._aligned(grid)
        shift = np.rint((np.array(grid.origin) - truth.origin)[::-1] / truth.resolution).astype(int)
        low = np.maximum(shift, 0)
        high = np.minimum(shift + grid.data.shape, truth.data.shape)
        data = truth.data.copy()
        if (high > low).all():
            window = data[low[0] : high[0], low[1] : high[1]]
            known = grid.data[low[0] - shift[0] : high[0] - shift[0], low[1] - shift[1] : high[1] - shift[1]]
            np.copyto(window, known, where=known >= 0)
        return OccupancyGrid(data, truth.resolution, truth.origin)

    def _aligned(self, grid: OccupancyGrid) -> OccupancyGrid:
        """Return the true map on cells that coincide with those of a map; maps grow by whole cells."""
        if self._grid is None:
            x_min, y_min, x_max, y_max = self._walls.bounds
            corners = np.array([[x_min, y_min], [x_min, y_max], [x_max, y_min], [x_max, y_max]])
            corners = self._start.inverse().transform(corners)
            resolution, origin = grid.resolution, np.array(grid.origin)
            low = np.floor((corners.min(axis=0) - origin) / resolution)
            width, height = np.ceil((corners.max(axis=0) - origin) / resolution).astype(int) - low.astype(int)
            x, y = (origin + low * resolution).tolist()
            data = np.full((height, width), OCCUPIED, dtype=np.int8)
            self._grid = OccupancyGrid(data, resolution, (x, y))
            centers = self._grid.centers(np.argwhere(data >= 0))
            cells = self._walls.cells(self._start.transform(centers))
            inside = self._walls.contains(cells)
            data.reshape(-1)[inside] = self._walls.data[tuple(cells[inside].T)]
        return self._grid
