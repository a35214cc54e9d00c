from types import SimpleNamespace

import numpy as np

from benchmarks.arena.trace import Recorder
from envs.estimation import MapUpdate
from envs.geometry import OccupancyGrid, Pose2D


def test_times_stay_under_their_cells_when_a_redrawn_map_has_other_borders():
    grid = OccupancyGrid(np.full((4, 6), -1, dtype=np.int8), 0.5, (0.0, 0.0))
    belief = SimpleNamespace(pose=Pose2D(0.0, 0.0, 0.0), grid=grid, update=None)
    recorder = Recorder(SimpleNamespace(belief=belief, robots=[None]))

    def watch(time, data, origin):
        grid.data, grid.origin = np.array(data, dtype=np.int8), origin
        belief.update = MapUpdate(np.argwhere(grid.data >= 0).astype(np.int32), None, True, origin)
        recorder.watch({"time": time})

    watch(1.0, [[-1, -1, -1], [-1, 0, -1]], (0.0, 0.0))
    watch(2.0, [[-1, -1, -1, -1], [-1, -1, 0, 100], [-1, -1, -1, -1]], (-0.5, 0.0))  # one more column to the left
    watch(3.0, [[0, 100], [0, -1]], (0.5, 0.5))  # the lowest row and two columns are gone
    np.testing.assert_array_equal(recorder._known_since, [[1.0, 2.0], [3.0, np.inf]])
