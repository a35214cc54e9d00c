import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.navigation import FrontierNavigator
from lidarnaut.envs.simulation import Reading
from tests.rooms import BURGER


def hall():
    """Hall of 10 m x 6 m. Openings in its short walls lead to unknown space; the left one is smaller."""
    data = np.full((160, 260), -1, dtype=np.int8)
    data[20:140, 30:230] = 0
    data[18:20, 28:232] = data[140:142, 28:232] = 100
    data[20:140, 28:30] = data[20:140, 230:232] = 100
    data[:, :14] = 100
    data[64:96, 28:30] = 0
    data[40:120, 230:232] = 0
    return OccupancyGrid(data, 0.05, (-1.5, -4.0))


def corridor(*unknown):
    """Closed corridor of 2 m x 20 m. `unknown`: (first, last) columns that are half unknown."""
    data = np.full((44, 400), 100, dtype=np.int8)
    data[2:42, 2:398] = 0
    for first, last in unknown:
        data[22:42, first : last + 1] = -1
    return OccupancyGrid(data, 0.05, (0.0, -1.1))


def belief_at(x, y, grid=None):
    return Belief(Pose2D(x, y, 0.0), grid or hall())


def reading_of(*, ranges=np.inf, bumper=False, time=0.0, robot=BURGER):
    """Sensor reading; `ranges` [m] may be one value for all beams."""
    ranges = np.full(robot.lidar.num_beams, ranges, dtype=np.float32)
    return Reading.of_scan(ranges, time)._replace(bumper=bumper)


def candidates_from(x, y, grid=None, **settings):
    navigator = FrontierNavigator(BURGER, 0.1, **settings)
    navigator.begin(reading_of(), belief_at(x, y, grid))
    return navigator.candidates


def first_choice(explorer, x, y, grid=None):
    """First frontier (x, y) chosen by a `RuleExplorer` from a position; None without frontiers."""
    candidates = candidates_from(x, y, grid, max_candidates=explorer.max_candidates, planning=explorer.planning)
    if len(candidates) == 0:
        return None
    if hasattr(explorer.rule, "reset"):
        explorer.rule.reset(BURGER, np.random.default_rng(0))
    return tuple(candidates["frontier"][explorer.rule(candidates, belief_at(x, y, grid)).argmax()].tolist())
