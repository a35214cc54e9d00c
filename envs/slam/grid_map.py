"""The map of TinySLAM, and of mapping with known poses."""

import numpy as np

from envs.estimation import MapUpdate, Window
from envs.geometry import Pose2D
from envs.robots import LidarParams

from .cells import unvisited_word
from .map_update import AVG, BASE, REPORT, InverseSensorModel, integrate_scan
from .mapping.growing_map import GrowingMap
from .params import TinySlamParams


class GridMap(GrowingMap):
    """Cells that accumulate observations of beams, and the occupancy grid that follows from them."""

    def __init__(self, params: TinySlamParams, lidar: LidarParams) -> None:
        """Make an unknown map with the map frame's origin in its middle."""
        super().__init__(lidar, params.resolution, (params.map_width, params.map_height), params.skip_exceeding)
        self.model = InverseSensorModel(
            {"avg": AVG, "base": BASE, "report": REPORT}[params.cell],
            params.estimator == "area",
            float(params.occupied_prob),
            float(params.empty_prob),
            params.hole_width / params.resolution,
            params.blur == "add",
        )
        self.unvisited = unvisited_word(params.unvisited)
        self.words = np.full(self.grid.data.shape, self.unvisited, dtype=np.int32)
        """Shape (height, width), int32: the cells."""

    def integrate(self, ranges: np.ndarray, pose: Pose2D, quality: float) -> MapUpdate:
        """Integrate a scan, shape (num_beams,), float32 [m], taken at a pose of the base, with a weight from 0 to 1."""
        x, y, extent = self._make_room(ranges, pose)
        new_cells = self._new_cells
        count = integrate_scan(self.words, self.grid.data, self._ends, x, y, self.model, float(quality), new_cells)
        return MapUpdate(new_cells[:count].copy(), Window(*extent), origin=self.grid.origin)

    def _pad(self, margins: tuple[tuple[int, int], tuple[int, int]]) -> None:
        super()._pad(margins)
        self.words = np.pad(self.words, margins, constant_values=self.unvisited)
