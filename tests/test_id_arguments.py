"""Each argument of each registered environment has an effect, or is refused by name."""

import math
import pickle
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.estimation.tracking import PeopleTracker
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.ids import arguments_of
from lidarnaut.envs.navigation.controllers.collision_monitor import CollisionMonitor
from lidarnaut.envs.tasks.route_map import RouteMap
from lidarnaut.envs.worlds import rasterize
from tests.rooms import BURGER, make_room
from tests.test_core import Beacon

IDS = [id for id in gymnasium.registry if id.startswith("lidarnaut/")]
ROOM, LARGER_ROOM = (
    replace(
        make_room(0.0, 0.0, width, 2.0, [(1.5, 0.0, 1.5, 1.2)], spawn=Pose2D(2.87, 1.0, 0.0)),
        goals=(Pose2D(0.4, 0.4, 0.0),),
        docks=(Pose2D(0.1, 1.0, math.pi), Pose2D(1.4, 0.6, 0.0)),
    )
    for width in (3.0, 4.0)
)
"""The robot starts in front of a wall; in the larger room, the wall is farther away."""
MAP = rasterize(LARGER_ROOM, 0.05)
CLUTTER = {"world": "clutter", "world_size": None}
RANDOM_GOAL = {"goal": "random"}
BASES = {
    "Track": {"world": ROOM, "map": MAP, "path": ((2.0, 1.0), (2.8, 1.0))},
    "Frontiers": {"world": "rooms", "world_size": (6.0, 6.0), "start": "spawn"},
    "": {"world": ROOM, "start": "spawn", "people": None, "goal": "world"},
}
"""Arguments of all cases, by a part of the id; those that the id does not have are left out."""
CHANGES = {
    "world": (LARGER_ROOM, {"world_size": None}),
    "split": ("test", CLUTTER),
    "world_size": ((13.0, 22.0), CLUTTER),
    "difficulty": (0.9, CLUTTER),
    "num_worlds": (1, CLUTTER),
    "start": ("random", {}),
    "map_resolution": (0.1, {"map_resolution": 0.2, "map": None}),
    "reward": ({"time": -7.0}, {}),
    "target_coverage": (0.01, {}),
    "return_home": (True, {}),
    "robot": (replace(BURGER, max_v=0.1), {}),
    "physics": ("bullet", {}),
    "control_hz": (7.0, {}),
    "time_limit": (0.3, {}),
    "observations": (("motion",), {}),
    "people": (1, {}),
    "track_people": (True, {}),
    "sensors": ([Beacon()], {}),
    "randomize": ({"lidar.noise_std": (0.05, 0.06)}, {}),
    "clip_actions": (True, {"contact": "costs"}),
    "collision_monitor": (True, {}),
    "render_mode": ("rgb_array", {}),
    "fixed_info": (True, {}),
    "cost": (True, {}),
    "num_robots": (3, {}),
    "max_candidates": (7, {}),
    "max_decision_time": (0.4, {}),
    "scan_distance": (0.9, {}),
    "drift": ((0.3, 0.05), {}),
    "false_returns": (0.3, {}),
    "goal": ("random", {}),
    "goal_tolerance": (50.0, {"heading_tolerance": math.pi}),
    "heading_tolerance": (1e-4, {"heading_tolerance": math.pi, "goal_tolerance": 50.0}),
    "min_distance": (2.4, {"min_distance": 0.1, **RANDOM_GOAL}),
    "goal_given": ("bearing", {}),
    "contact": ("costs", {}),
    "localizer": ("truth", {}),
    "amcl": ("nav2", {}),
    "initial_pose": ("unknown", {}),
    "map": (MAP, {"map": None}),
    "map_pose": ((0.1, 0.0, 0.2), {"map": MAP}),
    "start_charge": ((0.9, 0.9), {}),
    "target_charge": (0.8, {}),
    "target_swept": (0.001, {}),
    "path": (((2.0, 1.0), (2.0, 1.6)), {}),
    "fusion": ("encoder", {"control_hz": 1.0}),
    "map_seed": (3, {"map": None}),
    "slam": ("tinyslam", {"map": None}),
    "map_latency": (2.0, {"control_hz": 1.0}),
    "max_deviation": (1e-6, {}),
    "start_spread": ((0.5, 0.5), {}),
    "task": ("lidarnaut.envs.tasks.sweep:Sweep", {}),
}
"""By argument: another value, and the values of other arguments with which it matters."""


@pytest.fixture
def calls(monkeypatch):
    """Count the calls of what need not change the robot's state, and replace a mapping drive, which takes time."""
    counts = {}

    def count(name, method):
        def counted(*args):
            counts[name] = counts.get(name, 0) + 1
            return method(*args)

        return counted

    for owner, name in ((PeopleTracker, "update"), (CollisionMonitor, "slow_down"), (Beacon, "measure")):
        monkeypatch.setattr(owner, name, count(name, getattr(owner, name)))

    def map_at_once(world, robot, *settings):
        counts["map"] = repr(settings)
        return RouteMap(MAP, 0.0, 0.0, np.zeros((1, 3)))

    monkeypatch.setattr("lidarnaut.envs.tasks.track.make_route_map", map_at_once)
    return counts


def outcome(id, calls, arguments):
    """Return all that an episode of a few steps shows, or the error that ends it."""
    env = gymnasium.make(id, disable_env_checker=True, **arguments)
    inner, space = lidar_env_of(env), env.action_space
    seen = [str(env.observation_space), str(space), env.reset(seed=0), calls.get("map")]
    calls.clear()  # of the reset
    try:
        for action in ((1.0, 0.0), (1.0, 0.0), (1.0, 0.3), (1.5, 0.0)):
            seen.append(env.step(np.resize(np.float32(action), space.shape) if space.shape else np.int64(1)))
            if seen[-1][2] or seen[-1][3]:
                break
    except ValueError as error:
        seen.append(str(error))
    belief = inner.belief
    seen += [dict(calls), inner.robot_params.name, inner.control_period, inner.time, inner.time_limit, inner.map_pose]
    seen += [inner.simulator.states, inner.simulator.people, inner.reading.extra]
    seen += [belief.pose, belief.covariance, belief.grid.data, np.shape(env.render()) if env.render_mode else None]
    calls.clear()
    env.close()
    return pickle.dumps(seen)


@pytest.mark.parametrize("id", IDS)
def test_each_argument_has_an_effect_or_is_refused(id, calls):
    allowed = arguments_of(id)
    base = next(base for part, base in BASES.items() if part in id)
    base = {"physics": "kinematic", "robot": "turtlebot3_burger", **base}
    normal, ignored = {}, []
    for name in allowed if "Frontiers" in id else allowed.keys() - {"task"}:
        value, others = CHANGES[name]
        common = {key: one for key, one in {**base, **others}.items() if key in allowed}
        if str(others) not in normal:
            normal[str(others)] = outcome(id, calls, common)
        try:
            changed = outcome(id, calls, {**common, name: value})
        except (TypeError, ValueError) as error:
            changed = str(error)
        if changed == normal[str(others)] or (isinstance(changed, str) and name not in changed):
            ignored.append(name)
    assert not ignored
