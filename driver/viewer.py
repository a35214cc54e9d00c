"""Estimates for RViz: map, plan, frontiers and the pose of the odometry frame."""

from typing import Any

import numpy as np

from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.logs import messages
from lidarnaut.envs.navigation import crop_to_known

from .driver import Driver

MAP_PERIOD = 2.0
"""Time between published maps [s]."""
MAX_CELLS = 400_000
"""Maximum number of cells of a published map: up to 1.6 MB of JSON, which keep a rosbridge server busy for a moment."""


class Viewer:
    """Publishes the estimates of a driver: a known map once, and one that grows each `MAP_PERIOD`."""

    def __init__(self, bridge: Any, map_frame: str, odom_frame: str) -> None:
        """Advertise the topics. `bridge`: connection that keeps the newest message, and whose `publish` never waits."""
        self._publish, self._frames, self._map_time = bridge.publish, (map_frame, odom_frame), -np.inf
        bridge.advertise("/map", "nav_msgs/msg/OccupancyGrid", latch=True)
        bridge.advertise("/plan", "nav_msgs/msg/Path")
        bridge.advertise("/frontiers", "visualization_msgs/msg/MarkerArray")
        bridge.advertise("/tf", "tf2_msgs/msg/TFMessage")

    def show(self, driver: Driver, now: float) -> None:
        """Publish the estimates at a time of the robot's clock [s]."""
        publish, overlay = self._publish, driver.env.overlay
        until = now + driver.env.control_period  # as AMCL, so that tf2 finds it for messages of the next period
        publish("/tf", messages.transforms(until, (*self._frames, driver.map_to_odometry)))
        publish("/plan", messages.path(now, np.empty((0, 2)) if driver.plan is None else driver.plan))
        if 0.0 <= now - self._map_time < MAP_PERIOD:
            return
        if driver.belief.grows or self._map_time == -np.inf:
            publish("/map", messages.occupancy_grid(now, limited(crop_to_known(driver.belief.grid, margin=0))))
        self._map_time = now
        if overlay.markers is not None and (markers := overlay.markers()) is not None:
            publish("/frontiers", messages.points(now, markers.clusters))


def limited(grid: OccupancyGrid) -> OccupancyGrid:
    """Return a copy of a map, with at most `MAX_CELLS` cells: of each square of cells the most occupied one counts."""
    factor = int(np.ceil(np.sqrt(grid.data.size / MAX_CELLS)))
    while -(-grid.data.shape[0] // factor) * -(-grid.data.shape[1] // factor) > MAX_CELLS:
        factor += 1
    data = grid.data
    for axis in (0, 1):
        data = np.maximum.reduceat(data, np.arange(0, data.shape[axis], factor), axis=axis)
    return OccupancyGrid(data, factor * grid.resolution, grid.origin)
