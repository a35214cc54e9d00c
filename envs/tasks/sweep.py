import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy import ndimage

from lidarnaut.envs.arguments import is_number
from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry.clearance import clearance, segment_offset
from lidarnaut.envs.measures import SWEEP
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Simulator

from .coverage import Frame
from .navigate import KnownMapTask


@njit(cache=True, error_model="numpy")
def sweep(unswept, frame, line, radius):
    """Clear the cells within `radius` [m] of a line; return the number of cleared cells.

    `unswept`: mask of cells, shape (height, width), bool, updated. `frame`: grid of the cells. `line`: (x0, y0, x1,
    y1), shape (1, 4), float64, in the frame of the grid [m].
    """
    side, count = frame.resolution, 0
    (left, low, right, high), (height, width) = line[0], unswept.shape
    left, right = min(left, right) - radius - frame.x, max(left, right) + radius - frame.x
    low, high = min(low, high) - radius - frame.y, max(low, high) + radius - frame.y
    for row in range(max(math.floor(low / side), 0), min(math.ceil(high / side), height)):
        for col in range(max(math.floor(left / side), 0), min(math.ceil(right / side), width)):
            dx, dy = segment_offset(frame.x + (col + 0.5) * side, frame.y + (row + 0.5) * side, line, 0)
            if unswept[row, col] and dx * dx + dy * dy <= radius * radius:
                unswept[row, col] = False
                count += 1
    return count


@dataclass(kw_only=True, eq=False)
class Sweep(KnownMapTask):
    """Sweep the floor of a known map.

    ## Description
    A robot sweeps all floor that its body reaches, on a known map. A localizer updates the pose estimate in each step
    (one control period). Observations contain no ground truth.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: forward speed and yaw rate (counter-clockwise) as fractions of the robot's limits.

    ## Observation Space
    `Dict`, egocentric:

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_beams,), float32)` | as in `Explore` |
    | `map_near` | `Box(0, 255, (3, 40, 40), uint8)` | known map, 8 m x 8 m around the estimated pose, 0.2 m per pixel |
    | `map_far` | `Box(0, 255, (3, 40, 40), uint8)` | known map, 32 m x 32 m around the estimated pose, 0.8 m per pixel |
    | `motion` | `Box(-1, 1, (6,), float32)` | as in `Explore` |
    | `pose_uncertainty` | `Box(0, 1, (3,), float32)` | standard deviations of position / 1 m and heading / pi (at most 1), 1 if the localizer is lost |

    Map channels as in `Explore`; channel 2 shows the driven path.

    ## Rewards
    The sum of `info["rewards"]`: `swept` (1 per m2 of newly swept floor), `time` (-0.02 per s of duration), `collision`
    (-0.5 per s in contact), `completed` (10, once, at `target_swept`). `reward` changes the weights.

    ## Starting State
    As in `Navigate`, without a goal. No floor is swept, except below the robot.

    ## Episode End
    1. Termination: the swept fraction reaches `target_swept`.
    2. Truncation: `time_limit` seconds have passed.

    A cell is swept if its centre is within the robot's radius of the true path. The floor consists of the cells that
    the body can cover with a clearance of half a cell to obstacles and to the cells that contain them. Collisions do
    not end the episode.

    ## Information
    Each step: `swept_fraction`, `swept_area` [m2], `is_lost`, `pose_error` (position [m], heading [rad]), `path_length`
    [m], `collisions` (contacts), `time` [s], `rewards`, `is_success`; at the end also `end_reason` (`"swept"` or
    `"time_limit"`). With `randomize` also `randomized` (drawn values by name).

    ## Arguments
    The arguments of `Navigate` except those of the goal, and

    | argument | default | meaning |
    |---|---|---|
    | `target_swept` | `0.9` | swept fraction of the floor that ends the episode |

    ## Version History
    * v0: first version
    """

    measures = SWEEP
    progress = "swept_fraction"
    weights = {"swept": 1.0, "time": -0.02, "collision": -0.5, "completed": 10.0}

    target_swept: float = 0.9

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        if not (is_number(self.target_swept) and 0 < self.target_swept <= 1):
            raise ValueError(f"target_swept must lie in (0, 1], got {self.target_swept!r}")
        self.success_condition = f"{100.0 * self.target_swept:g} % of the floor is swept"
        super().attach(robot, control_period, physics)

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        walls, radius, self._pose = self.area.walls, self.robot.radius, self.starts[0]
        self._raster = Frame(*map(float, (*walls.origin, walls.resolution)))
        # Half a cell of clearance, as in planning. Obstacles lie anywhere in their cells.
        distances, reached = partial(ndimage.distance_transform_edt, sampling=walls.resolution), self.area.traversable
        to_walls, least = distances(walls.data == 0), radius + 0.5 * walls.resolution
        roomy = reached & (to_walls > least + 1e-9)
        near, obstacles = roomy & (to_walls < least + walls.resolution), (self._world.segments, self._world.circles)
        roomy[near] = [clearance(x, y, *obstacles) >= least - 1e-9 for x, y in walls.centers(np.argwhere(near))]
        self.unswept = distances(~(roomy if roomy.any() else reached)) <= radius
        """True floor cells to sweep, shape of the raster, bool."""
        self.floor_area, self.swept_area = float(self.unswept.sum()) * walls.resolution**2, 0.0
        self.update(simulator, robots, 0.0)
        # Four times the duration of lanes without overlap at maximum speed.
        return 120.0 + 10.0 * round(0.2 * self.floor_area / (radius * self.robot.max_v))

    @property
    def swept_fraction(self) -> float:
        """Swept fraction of the floor."""
        return self.swept_area / self.floor_area

    def update(self, simulator: Simulator, robots: Sequence[Robot], period: float) -> None:
        before, self._pose = self._pose, simulator.states[0].pose
        line = np.array([[*before[:2], *self._pose[:2]]])
        swept = sweep(self.unswept, self._raster, line, self.robot.radius) * self._raster.resolution**2
        self.swept_area += swept
        self.end_reason = "swept" if self.swept_fraction >= self.target_swept - 1e-9 else None
        self._quantities = {"swept": swept, "completed": float(self.end_reason is not None)}

    def metrics(self) -> dict[str, Any]:
        swept = {"swept_fraction": self.swept_fraction, "swept_area": self.swept_area}
        return {**swept, "is_lost": self.robots[0].belief.is_lost, "is_success": self.end_reason is not None}
