import itertools
import math
from dataclasses import asdict
from functools import partial

import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence as same

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.decisions.abstract import ExploreFrontiersAbstractEnv
from lidarnaut.envs.decisions.explore_frontiers import ExploreFrontiersEnv
from lidarnaut.envs.estimation import Correction, MapUpdate
from lidarnaut.envs.geometry import Pose2D, Window
from lidarnaut.envs.navigation import GainOverCost
from lidarnaut.envs.navigation.controllers.collision_monitor import CollisionMonitor
from lidarnaut.envs.navigation.frontiers.candidates import COST
from lidarnaut.envs.period import Period
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.slam import GMapping, GraphSlam, Hector, KnownPoses, TinySlam, load_params
from lidarnaut.envs.tasks.explore import Explore
from tests.rollouts import nearest, rollout

QUICK = {"world": "rooms", "world_size": (6.0, 6.0), "physics": "kinematic"}
MOST_STEPS = 20 + 4 * 12
"""Maximum control steps of a decision: 4 s at 5 Hz, plus the recovery manoeuvres before the robot gives up."""


explore = partial(rollout, rule=nearest)


class Jumping(KnownPoses):
    """Turns and moves its map and its pose at every fifth key scan, like a loop closure."""

    num_jumps = 0

    def process_key_scan(self, ranges, predicted):
        belief = super().process_key_scan(ranges, predicted)
        self.count = getattr(self, "count", 0) + 1
        if self.count % 5 == 0:
            rows, cols = belief.grid.data.shape
            belief.grid.data = np.roll(belief.grid.data, (-1, 3), (0, 1))
            before = np.array([belief.pose])
            belief.pose = self.last_key_pose = Pose2D(0.15, -0.05, 0.0).compose(belief.pose)
            belief.path = np.array([belief.pose])
            known = np.argwhere(belief.grid.data >= 0).astype(np.int32)
            window, correction = Window(0, 0, rows, cols), Correction(before, belief.path)
            belief.update = MapUpdate(known, window, True, belief.grid.origin, correction)
            self.map.words = np.roll(self.map.words, (-1, 3), (0, 1))
            type(self).num_jumps += 1
        return belief


def users_own(kind):
    update = lambda self, reading, motion: kind.update(self, reading, motion)  # noqa: E731
    return type(f"Own{kind.__name__}", (kind,), {"update": update, "num_jumps": 0})


OwnTinySlam, OwnJumping, OwnGMapping = map(users_own, (TinySlam, Jumping, GMapping))
LOADERS = {
    OwnTinySlam: ("tinyslam", load_params),
    users_own(KnownPoses): ("odometry", load_params),
    users_own(Hector): ("hector", partial(load_params, slam="hector")),
    OwnGMapping: ("gmapping", partial(load_params, slam="gmapping")),
    users_own(GraphSlam): ("graph", partial(load_params, slam="graph")),
    OwnJumping: (lambda lidar, resolution: Jumping(lidar, load_params("default")), load_params),
}


ROBOTS = itertools.cycle(["turtlebot3_burger", "raspimouse"])


def make_own(kind, noise, lidar, resolution):
    return kind(lidar, LOADERS[kind][1]("default", {"resolution": resolution, "odometry_noise": noise}))


@pytest.mark.parametrize(("own", "robot"), [*zip(LOADERS, ROBOTS), (OwnTinySlam, "raspimouse")])
def test_drives_by_a_kernel_equal_drives_step_by_step(own, robot):
    arguments = {**QUICK, "robot": robot, "time_limit": 40.0, "reward": {"collision": -1.0}}
    noise = asdict(load_robot(robot).odometry.noise)
    by_kernel = explore(ExploreFrontiersEnv(slam=LOADERS[own][0], **arguments), 3, 12)
    step_by_step = explore(ExploreFrontiersEnv(slam=partial(make_own, own, noise), **arguments), 3, 12)
    for a, b in zip(by_kernel, step_by_step, strict=True):
        assert same(a[0], b[0])
        info, other = dict(a[-1]), dict(b[-1])
        assert info.pop("rewards") == pytest.approx(other.pop("rewards"))
        assert same(info, other)
        assert a[1:-1] == pytest.approx(b[1:-1])
    assert own is not OwnJumping or Jumping.num_jumps > 4 < OwnJumping.num_jumps


def test_drives_by_a_kernel_equal_those_step_by_step_where_the_best_particle_changes():
    slams, outs = [], []

    def make(kind, lidar, resolution):
        changes = {"resolution": resolution, "likelihood_gain": 1.0, "residual_variance": 0.02, "switch_margin": 0.0}
        slams.append(kind(lidar, load_params("default", changes, "gmapping")))
        return slams[-1]

    for kind in (GMapping, OwnGMapping):
        env = ExploreFrontiersEnv(slam=partial(make, kind), **QUICK, time_limit=40.0)
        outs.append(explore(env, 3, 12))
    assert slams[0].num_switches == slams[1].num_switches > 3
    assert all(same(a[0], b[0]) for a, b in zip(*outs, strict=True))


def test_the_mask_shows_the_candidates_and_the_features_are_theirs():
    env = ExploreFrontiersEnv(**QUICK)
    for observation, *_, info in explore(env, 2, 12):
        assert observation in env.observation_space
        mask = observation["action_mask"]
        assert mask.dtype == info["action_mask"].dtype == np.int8
        np.testing.assert_array_equal(mask, info["action_mask"])
        assert (observation["candidates"][mask == 0] == 0.0).all()
        costs = observation["candidates"][mask == 1, COST]
        assert (np.diff(costs) >= 0.0).all()
        assert ((costs >= 0.0) & (costs < 1.0)).all()
        assert (np.diff(mask) <= 0).all()
    np.testing.assert_array_equal(env.action_masks(), mask == 1)
    assert env.action_masks().dtype == np.bool_


def test_an_action_without_a_candidate_takes_the_last_one():
    env, other = ExploreFrontiersEnv(**QUICK), ExploreFrontiersEnv(**QUICK)
    observation, _ = env.reset(seed=3)
    other.reset(seed=3)
    count = int(observation["action_mask"].sum())
    assert 1 <= count < env.action_space.n
    forced, chosen = env.step(env.action_space.n - 1), other.step(count - 1)
    assert forced[4]["action"] == count - 1
    assert same(forced, chosen)


def test_rewards_are_those_of_the_control_steps(monkeypatch):
    env = ExploreFrontiersEnv(**QUICK, slam=partial(make_own, OwnTinySlam, {}), reward={"collision": -1.0})
    observation, info = env.reset(seed=5)
    taken = []
    run = Period.run

    def spy(period, commands):
        # Driving straight on, without the navigator, the robot hits a wall.
        run(period, np.array([[env.robot_params.max_v, 0.0]]))
        taken.append(env.explore.outcome()[3]["rewards"])

    monkeypatch.setattr(Period, "run", spy)
    collision = 0.0
    for _ in range(8):
        taken.clear()
        before = info
        observation, reward, _, _, info = env.step(nearest(observation))
        assert reward == pytest.approx(sum(sum(rewards.values()) for rewards in taken))
        for name in Explore.weights:
            assert info["rewards"][name] == pytest.approx(sum(rewards[name] for rewards in taken))
        collision += info["rewards"]["collision"]
        assert info["decision_steps"] == len(taken) <= MOST_STEPS
        assert info["decision_time"] == pytest.approx(info["time"] - before["time"]) == pytest.approx(0.2 * len(taken))
        assert info["decision_length"] == pytest.approx(info["path_length"] - before["path_length"])
        assert info["area_left"] == pytest.approx(
            info["explored_area"] / info["explored_fraction"] - info["explored_area"]
        )
    assert collision < 0.0


@pytest.mark.parametrize("kind", [ExploreFrontiersEnv, ExploreFrontiersAbstractEnv])
def test_an_infinite_time_limit_is_one_that_never_comes(kind):
    rollouts = [explore(kind(**QUICK, time_limit=limit), 1, 12) for limit in (math.inf, 1e9)]
    for ours, theirs in zip(*rollouts, strict=True):
        assert same(ours, theirs)


def test_nothing_left_to_reach_terminates():
    # Some corners of this world stay unknown in episodes of any length.
    env = ExploreFrontiersEnv(world="aws_small_house", physics="kinematic", slam="hector", target_coverage=1.0)
    out = explore(env, 0, 1000)
    observation, _, terminated, truncated, info = out[-1]
    assert (terminated, truncated, info["end_reason"]) == (True, False, "no_reachable_frontier")
    assert not observation["action_mask"].any()
    assert info["explored_fraction"] > 0.95
    assert info["area_left"] > 0.0
    assert "map_iou" in info


LARGER = {**QUICK, "world_size": (8.0, 8.0), "target_coverage": 0.95}


def explore_by_rule(env, seed):
    rule = GainOverCost()
    env.reset(seed=seed)
    positions = [env.explore.truths[0].state.pose[:2]]
    while True:
        _, _, terminated, truncated, info = env.step(np.int64(rule(env.candidates, env.belief).argmax()))
        positions.append(env.explore.truths[0].state.pose[:2])
        if terminated or truncated:
            return info, np.array(positions)


def test_abstract_worlds_have_the_spaces_of_the_real_one_and_are_explored_in_about_its_time():
    times = []
    abstract = ExploreFrontiersAbstractEnv(**LARGER, map_resolution=0.1)
    real = ExploreFrontiersEnv(slam="truth", **LARGER)
    assert abstract.observation_space == real.observation_space
    assert abstract.action_space == real.action_space
    for env in (abstract, real):
        infos = [explore_by_rule(env, seed)[0] for seed in range(6)]
        assert all(info["end_reason"] == "covered" for info in infos)
        times.append(np.mean([info["time"] for info in infos]))
    assert times[0] == pytest.approx(times[1], rel=0.3)


@pytest.mark.parametrize(("drift", "least", "most"), [((0.0, 0.0), 0.0, 1e-9), ((0.05, 0.02), 0.005, 0.25)])
def test_the_abstract_robot_is_no_faster_than_the_real_one_and_its_pose_drifts_as_asked(drift, least, most):
    env = ExploreFrontiersAbstractEnv(**LARGER, drift=drift)
    info, positions = explore_by_rule(env, 0)
    error, turn = info["pose_error"]
    assert least <= error <= most
    assert turn <= 0.1
    assert info["path_length"] <= env.robot_params.max_v * info["time"] + 1e-6
    area = env.explore.task.coverage.area
    cells = area.walls.cells(positions)
    assert all(area.traversable[r - 1 : r + 2, c - 1 : c + 2].any() for r, c in cells)


def test_slides_are_a_physics_of_which_the_abstract_environment_is_a_preset():
    preset = explore(ExploreFrontiersAbstractEnv(**LARGER), 2, 8)
    slides = explore(ExploreFrontiersEnv(**LARGER | {"physics": "slide"}), 2, 8)
    assert all(same(ours, theirs) for ours, theirs in zip(slides, preset, strict=True))
    for argument, value in {"slam": "hector", "people": 2, "return_home": True}.items():
        with pytest.raises(ValueError, match=argument):
            ExploreFrontiersEnv(**LARGER | {"physics": "slide", argument: value})


def test_an_abstract_lidar_that_looks_ahead_looks_around():
    env = ExploreFrontiersAbstractEnv(**LARGER | {"robot": "raspimouse", "target_coverage": 0.8})
    info, _ = explore_by_rule(env, 1)
    assert info["explored_fraction"] > 0.5


def test_a_collision_monitor_slows_the_navigator_down(monkeypatch):
    def stop(self, commands, ranges, active):
        commands[:, 0] = 0.0

    monkeypatch.setattr(CollisionMonitor, "slow_down", stop)
    for has_one in (False, True):
        env = ExploreFrontiersEnv(**QUICK, collision_monitor=has_one)
        info = explore(env, 3, 2)[-1][-1]
        assert env.is_fused != has_one
        assert (info["path_length"] < 0.05) == has_one


def test_gaps_to_people_that_are_not_measured_are_nan():
    env = ExploreFrontiersAbstractEnv(world="turtlebot3_stage_4", time_limit=4.0)
    info = explore(env, 0, 20)[-1][-1]
    assert info["end_reason"] == "time_limit"
    for name in ("least_gap", "least_time_to_collision", "intrusion_time", "hit_wall", "hit_person", "hit_by_person"):
        assert math.isnan(info[name])


@pytest.mark.parametrize("kind", [ExploreFrontiersEnv, ExploreFrontiersAbstractEnv])
def test_windows_show_the_drive(kind, monkeypatch):
    times = []
    monkeypatch.setattr(LidarEnv, "render", lambda self: times.append(self.time))
    env = kind(**QUICK, render_mode="human")
    info = explore(env, 3, 2)[-1][-1]
    assert times == sorted(times)
    assert (times[0], times[-1]) == (0.0, info["time"])
    assert len(times) > 5
