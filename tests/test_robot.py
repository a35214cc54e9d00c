"""Checks of beliefs and map updates of user-defined estimators."""

import math

import numpy as np
import pytest

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.estimation import Belief, MapUpdate
from lidarnaut.envs.estimation.belief import check_belief
from lidarnaut.envs.geometry import ORIGIN, OccupancyGrid, Pose2D, Window
from lidarnaut.envs.slam import Hector, KnownPoses, load_params
from lidarnaut.envs.tasks.explore import Explore, ExploreTeam
from tests.rooms import BURGER
from tests.test_core import QUICK, STILL, Own

CELLS = np.array([[3, 4], [5, 6]], dtype=np.int32)
FAR = np.array([[3, 100_000]], dtype=np.int32)


def replacing(**fields):
    """Return a function that replaces fields of a belief, or of its grid, by results of functions."""

    def spoil(belief):
        for name, make in fields.items():
            setattr(belief if hasattr(belief, name) else belief.grid, name, make(belief))

    return spoil


def updating(cells=CELLS, window=(0, 0, 9, 9), **further):
    return replacing(update=lambda belief: MapUpdate(cells, window, **{"origin": belief.grid.origin, **further}))


def reach_one_too_far(belief):
    height, width = belief.grid.data.shape
    updating(window=Window(0, 0, height + 1, width))(belief)


def reshape(belief):
    height, width = belief.grid.data.shape
    belief.grid.data.shape = height // 2, 2 * width


FAULTS = {
    "window ends beyond": (reach_one_too_far, r"window .* the grid has \d+ rows and \d+ columns"),
    "window begins before": (updating(window=Window(0, -1, 4, 5)), "window"),
    "window is empty": (updating(window=Window(5, 5, 2, 0)), "window"),
    "window of floats": (updating(window=Window(0, 0.0, 4, 4)), "window"),
    "cell beyond": (updating(FAR), r"new_cells .* the grid has \d+ rows and \d+ columns"),
    "cell before": (updating(-CELLS), "new_cells"),
    "changed cell beyond": (updating(changed_cells=FAR), r"changed_cells .* the grid has \d+ rows"),
    "changed cells of floats": (updating(changed_cells=CELLS / 2), "changed_cells .* integers"),
    "cells elsewhere": (updating(origin=(90.0, 0.0)), "new_cells"),
    "cells of floats": (updating(CELLS.astype(float)), r"new_cells .* integers.*3\."),
    "cells in columns": (updating(np.vstack([CELLS, CELLS]).T), r"new_cells .* shape \(k, 2\)"),
    "cells in a list": (updating(CELLS.tolist()), r"new_cells .* \[\["),
    "origin is NaN": (updating(origin=(math.nan, 0.0)), "finite"),
    "pose is NaN": (replacing(pose=lambda belief: belief.pose._replace(theta=math.nan)), "finite.*nan"),
    "pose is infinite": (replacing(pose=lambda belief: belief.pose._replace(x=math.inf)), "finite.*inf"),
    "path with a NaN": (replacing(path=lambda _: np.full((4, 3), math.nan)), "path"),
    "data of floats": (replacing(data=lambda belief: belief.grid.data.astype(float)), "data .* int8.* float64"),
    "data in 3D": (replacing(data=lambda belief: belief.grid.data[None]), "data .* int8"),
    "data in another shape": (reshape, "data .* shape"),
    "another grid": (replacing(grid=lambda belief: OccupancyGrid(belief.grid.data, 0.05, (0.0, 0.0))), "OccupancyGrid"),
}


class Faulty(Own):
    def reset(self, *args, **kwargs):
        self._count = 0
        return super().reset(*args, **kwargs)

    def update(self, reading, motion):
        belief = super().update(reading, motion)
        self._count += 1
        if self._count == 2:
            self.spoil(belief)
        return belief

    @staticmethod
    def spoil(belief):
        """Leave the belief unchanged."""


@pytest.mark.parametrize("fault", FAULTS)
def test_a_belief_that_maps_cannot_work_with_is_refused(fault, monkeypatch):
    spoil, says = FAULTS[fault]
    env = LidarEnv(Explore, **QUICK, slam=Faulty)
    with monkeypatch.context() as patch:
        patch.setattr(Faulty, "spoil", staticmethod(spoil))
        env.reset(seed=0)
        with pytest.raises(ValueError, match=f"Faulty.*{says}"):
            env.step(STILL)
    env.reset(seed=0)
    env.step(STILL)


class Overriding:
    """Mixin of estimators."""

    def update(self, reading, motion):
        return super().update(reading, motion)


class KeyPoses(Hector):
    def is_key_pose(self, pose):
        return super().is_key_pose(pose)


class Declaring(Overriding, Hector):
    follows_odometry = True


class Mixed(Overriding, Hector):
    pass


class Plain(Hector):
    pass


@pytest.mark.parametrize(("kind", "follows"), [(Plain, True), (Declaring, True), (Mixed, False), (KeyPoses, False)])
def test_a_slam_that_overrides_updates_gets_every_scan_unless_it_declares_otherwise(kind, follows):
    assert kind(BURGER.lidar, load_params("default", slam="hector")).follows_odometry is follows
    assert kind(BURGER.lidar, load_params("default", {"match_every_scan": True}, slam="hector")).follows_odometry is (
        kind is Declaring
    )


def test_a_slam_that_returns_no_belief_is_named(monkeypatch):
    monkeypatch.setattr(Faulty, "update", lambda self, ranges, motion: None)
    with pytest.raises(ValueError, match=r"Faulty.*Belief.*None"):
        LidarEnv(Explore, **QUICK, slam=Faulty).reset(seed=0)


def test_a_team_whose_robots_have_maps_of_their_own_is_refused(monkeypatch):
    monkeypatch.setattr(Faulty, "reset", lambda self, rng, pose=ORIGIN, map=None: KnownPoses.reset(self, rng, pose))
    monkeypatch.setattr(Faulty, "update", KnownPoses.update)
    with pytest.raises(ValueError, match=r"Faulty.*OccupancyGrid"):
        LidarEnv(ExploreTeam, **QUICK, slam=Faulty, num_robots=2).reset(seed=0)


def test_cells_may_be_counted_from_where_the_map_began_before_it_grew():
    grid = OccupancyGrid(np.zeros((20, 10), dtype=np.int8), 0.05, (-0.35, -0.5))
    belief = Belief(Pose2D(0.0, 0.0, 0.0), grid)
    cells = np.array([[-10, -7], [9, 2]], dtype=np.int32)
    belief.update = MapUpdate(cells, Window(0, 0, 20, 10), origin=(0.0, 0.0))
    check_belief(belief, "mine")
    for off in ((-1, 0), (0, -1), (1, 0), (0, 1)):
        belief.update = belief.update._replace(new_cells=cells + np.array(off, dtype=np.int32))
        with pytest.raises(ValueError, match=r"mine.*new_cells"):
            check_belief(belief, "mine")
