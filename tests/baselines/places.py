"""Maps that explorers choose in."""

import numpy as np

from baselines.survey import Survey
from envs.geometry import OccupancyGrid, Pose2D
from envs.navigation import CostmapParams
from envs.robots import load_robot
from envs.simulation import Reading
from envs.slam import Belief

BURGER = load_robot("turtlebot3_burger")
NO_CELLS = np.empty((0, 2), dtype=np.int32)


def hall():
    """A hall of 10 m x 6 m; through openings in its short walls it borders on the unknown: little of it on the left."""
    data = np.full((160, 260), -1, dtype=np.int8)
    data[20:140, 30:230] = 0
    data[18:20, 28:232] = data[140:142, 28:232] = 100
    data[20:140, 28:30] = data[20:140, 230:232] = 100
    data[:, :14] = 100
    data[64:96, 28:30] = 0
    data[40:120, 230:232] = 0
    return OccupancyGrid(data, 0.05, (-1.5, -4.0))


def belief_at(x, y, grid=None):
    return Belief(Pose2D(x, y, 0.0), grid or hall(), NO_CELLS)


def survey_from(x, y, grid=None):
    return Survey(belief_at(x, y, grid), CostmapParams(0.155, 0.6, 4.0))


def chosen_by(explorer, survey):
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    return explorer._choose(survey)


def observation_of(*, bump=False, action=(0.0, 0.0), scan=1.0):
    motion = np.array([*action, *action, bump, 0.0], dtype=np.float32)
    return {"scan": np.full(BURGER.lidar.num_beams, scan, dtype=np.float32), "motion": motion}


def reading_of(*, ranges=np.inf, ticks=(0, 0), yaw_rate=0.0, bumper=False):
    """What a burger's sensors say; `ranges` [m] may be one for all beams."""
    ranges = np.full(BURGER.lidar.num_beams, ranges, dtype=np.float32)
    return Reading(time=0.0, ranges=ranges, ticks=ticks, yaw_rate=yaw_rate, heading=np.nan, bumper=bumper)
