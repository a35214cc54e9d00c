import math

import gymnasium
import numpy as np
import pytest

from lidarnaut.baselines.episode import begin_episode, decide_with, run, run_episode
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.estimation import DeadReckoning
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D, wrap_angle
from lidarnaut.envs.navigation import GoalNavigator
from lidarnaut.envs.tasks.navigate import Navigate
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from lidarnaut.envs.worlds import World, save_map
from tests.rollouts import play, rollout

QUICK = {"world": "turtlebot3_world", "physics": "kinematic"}
TRUE = {**QUICK, "localizer": "truth"}
STOP = np.zeros(2, dtype=np.float32)


def edges_of(x0, y0, x1, y1):
    return [(x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0)]


def test_the_goal_is_observed_from_the_estimated_pose():
    env = LidarEnv(Navigate, **TRUE, start=(-2.0, -0.5, math.pi / 2), goal=(-0.5, -0.5, math.pi))
    observation, info = env.reset(seed=0)
    assert info["distance_to_goal"] == pytest.approx(1.5)
    np.testing.assert_allclose(observation["goal"], [1.5 / 32.0, 0.0, -1.0, 0.0, 1.0], atol=1e-6)


def test_goals_need_a_heading_only_if_one_is_asked_for_and_change_without_a_reset():
    settings = {**TRUE, "start": (-2.0, -0.5, 0.0), "goal": (-2.0, -0.45, 2.0)}
    env, asks = (
        LidarEnv(Navigate, **settings | {"goal": (-2.0, -0.45)}),
        LidarEnv(Navigate, **settings, heading_tolerance=0.3),
    )
    assert env.reset(seed=0)[1]["is_success"]
    assert not asks.reset(seed=0)[1]["is_success"]
    assert env.reset(seed=0, options={"goal": (-2.0, 0.5)})[1]["distance_to_goal"] == pytest.approx(1.0)
    env.step(STOP)
    env.set_goal((-0.5, -0.5))
    info = env.step(STOP)[4]
    assert (info["distance_to_goal"], info["time"]) == (pytest.approx(1.5, abs=0.01), pytest.approx(0.2))
    assert info["rewards"]["progress"] == pytest.approx(0.0, abs=0.02)
    with pytest.raises(ValueError, match="heading_tolerance asks for a heading"):
        asks.reset(seed=0, options={"goal": (-0.5, -0.5)})


def from_start(task, x, y, *heading):
    """Return a goal relative to the start, in the map frame, and the arguments of the task with exact poses."""
    if task is ReachGoal:
        return (x, y, *heading), {**QUICK, "slam": "truth", "start": (-2.0, -0.5, 0.0)}
    return (x - 2.0, y - 0.5, *heading), {**TRUE, "start": (-2.0, -0.5, 0.0)}


@pytest.mark.parametrize("task", [Navigate, ReachGoal])
@pytest.mark.parametrize(
    ("heading", "tolerance", "is_reached"),
    [
        ((), None, True),
        ((0.24,), None, True),
        ((0.26,), None, False),
        ((2.0 * math.pi - 0.24,), None, True),
        ((3.0,), math.pi, True),  # a given tolerance has precedence
        ((0.24,), 0.1, False),
    ],
)
def test_a_heading_that_is_given_is_part_of_the_goal(task, heading, tolerance, is_reached):
    goal, arguments = from_start(task, 0.0, 0.05, *heading)
    env = LidarEnv(task, **arguments, heading_tolerance=tolerance)
    env.reset(seed=0, options={"goal": goal})
    *_, is_over, _, info = env.step(STOP)
    assert (is_over, info["is_success"], info["progress"] == 1.0) == (is_reached,) * 3
    if tolerance is None:  # drawn goals ask for no heading
        env.reset(seed=0)
        assert env.task.heading_tolerance == math.pi
        env.set_goal(goal)
        assert env.step(STOP)[2] == is_reached


@pytest.mark.parametrize("task", [Navigate, ReachGoal])
@pytest.mark.parametrize("policy", ["pursuit", "dwb", "mppi"])
@pytest.mark.parametrize("arguments", [{}, {"goal_tolerance": 0.1, "heading_tolerance": 0.1}])
def test_classic_policies_take_the_heading_of_the_goal(task, policy, arguments):
    goal, settings = from_start(task, 0.8, 0.0, 2.5)
    env = LidarEnv(task, **settings, **arguments, goal=goal)
    episode = play(env, policy)
    assert (episode.end_reason, episode.collisions) == ("reached", 0)
    assert episode.duration < 12.0
    turn = wrap_angle(env.simulator.states[0].pose.theta - 2.5)
    assert abs(turn) <= arguments.get("heading_tolerance", 0.25)


def test_localisers_differ_as_they_should():
    errors = {}
    for localizer in ("truth", "odometry", "amcl"):
        env = LidarEnv(Navigate, **QUICK, localizer=localizer)
        errors[localizer] = np.mean([rollout(env, seed, 150)[-1][4]["pose_error"] for seed in range(3)], axis=0)
    assert errors["truth"].sum() < 1e-9
    assert errors["odometry"][0] > 1e-3
    assert errors["amcl"][0] < 0.15
    grid = OccupancyGrid(np.zeros((3, 3), dtype=np.int8), 0.1, (0, 0))
    with pytest.raises(ValueError, match="needs a start pose"):
        DeadReckoning().reset(grid, None, np.random.default_rng())


def test_a_saved_map_in_its_own_frame(tmp_path):
    frame = (-2.0, -0.5, 0.5)
    plain = LidarEnv(Navigate, **TRUE, start="spawn", goal=(-0.5, -0.5, 0.0))
    _, info = plain.reset(seed=0)
    path = save_map(plain.belief.grid, tmp_path / "map")
    goal = tuple(Pose2D(*frame).between(Pose2D(-0.5, -0.5, 0.0)))
    framed = LidarEnv(Navigate, **TRUE, start="spawn", goal=goal, map=path, map_pose=frame)
    _, again = framed.reset(seed=0)
    assert again["distance_to_goal"] == pytest.approx(info["distance_to_goal"])
    assert tuple(framed.belief.pose) == pytest.approx(Pose2D(*frame).between(Pose2D(-2.0, -0.5, 0.0)))
    assert again["pose_error"].sum() < 1e-9
    np.testing.assert_array_equal(framed.belief.grid.data, plain.belief.grid.data)


def test_a_robot_in_one_of_two_equal_rooms_looks_on_until_it_knows_which():
    lines = [(0, 0, 6, 0), (0, 0, 0, 2), (6, 0, 6, 2), *edges_of(4.8, 0.0, 5.2, 0.4)]
    for x in (0, 3):
        lines += [(x, 2, x, 5), (x + 3, 2, x + 3, 5), (x, 5, x + 3, 5), (x, 2, x + 1, 2), (x + 2, 2, x + 3, 2)]
        lines += edges_of(x + 0.2, 4.2, x + 0.8, 4.8)
    segments = np.array(lines, dtype=float)
    world = World("rooms", segments, np.empty((0, 3)), (Pose2D(1.5, 3.5, 0.0),), (-0.1, -0.1, 6.1, 5.1))
    start, goal = (4.5, 3.5, 0.3), (0.6, 0.6, 0.0)
    env = LidarEnv(Navigate, world=world, physics="kinematic", initial_pose="unknown", start=start, goal=goal)
    driver, seen = GoalNavigator(), []
    observation, info = begin_episode(env, driver, 0, np.random.default_rng(0))
    assert info["is_lost"]
    assert observation["pose_uncertainty"][2] == 1.0

    def watch(info):
        seen.append((len(env.belief.hypotheses), info["is_lost"], info["pose_error"][0]))

    ended = run(env, decide_with(driver, env), observation, info, watch)
    assert ended.info["end_reason"] == "reached"
    assert max(seen)[0] == 2
    assert max(error for _, is_lost, error in seen if not is_lost) < 0.3


@pytest.mark.parametrize("wrong", ["kitchen", None, (0.0,), (0.0, math.nan), (0.0, 0.0, 0.0), (9.0, 0.0)])
def test_a_goal_that_no_robot_can_take_is_refused_and_leaves_the_one_before(wrong):
    """A name, incomplete poses, a pillar, and a point outside of the walls."""
    goal, is_pose = (-0.5, 0.5, 0.0), wrong in ((0.0, 0.0, 0.0), (9.0, 0.0))
    culprit = "is not reachable by the robot" if is_pose else "goal must be.*all finite"
    env = LidarEnv(Navigate, **QUICK, goal=goal)
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset"):
        env.set_goal(goal)
    with pytest.raises(ValueError, match=culprit):
        env.reset(seed=0, options={"goal": wrong})
    env.reset(seed=0)
    with pytest.raises(ValueError, match=culprit):
        env.set_goal(wrong)
    assert tuple(env.task.goal) == goal
    *_, terminated, _, info = env.step(STOP)
    assert not terminated
    assert info["distance_to_goal"] < 5.0


def test_a_given_initial_pose_may_be_wrong_and_is_corrected():
    start, offset = (-2.0, -0.5, 0.0), Pose2D(0.3, -0.2, 0.15)
    frame = Pose2D(1.0, 2.0, 0.5 * math.pi)
    plain = LidarEnv(Navigate, **QUICK, start=start)
    plain.reset(seed=0)
    grid = plain.belief.grid
    # Turned by a quarter: x of the map is y of the world, and y of the map is -x.
    left, low = grid.origin[1] - frame.y, frame.x - grid.origin[0] - grid.data.shape[1] * grid.resolution
    turned = OccupancyGrid(np.ascontiguousarray(grid.data.T[::-1]), grid.resolution, (left, low))
    given = frame.between(Pose2D(*start).compose(offset))
    settings = {**QUICK, "start": start, "map": turned, "map_pose": frame}
    settings["goal"] = tuple(frame.between(Pose2D(0.5, 1.5, 0.0)))
    env = LidarEnv(Navigate, **settings, initial_pose=given)
    _, info = env.reset(seed=0)
    assert info["pose_error"] == pytest.approx([math.hypot(0.3, 0.2), 0.15], abs=0.05)
    particles = env.robots[0].estimator.particles
    np.testing.assert_allclose(particles.std(axis=0), [0.5, 0.5, math.radians(15.0)], rtol=0.1)
    first = env.belief.pose
    episode = run_episode(env, GoalNavigator(), 0)
    assert episode.end_reason == "reached"
    assert episode.history.final["pose_error"][0] < 0.15
    other = LidarEnv(Navigate, **settings)
    other.reset(seed=0, options={"initial_pose": list(given)})
    assert tuple(other.belief.pose) == tuple(first)
    other.reset(seed=0)
    assert tuple(other.belief.pose) != tuple(first)


@pytest.mark.parametrize("wrong", ["here", (1.0, 2.0), (0.0, math.nan, 0.0), None, 3])
def test_wrong_initial_poses_are_named(wrong):
    with pytest.raises(ValueError, match=r"initial_pose must be 'known', 'unknown' or \(x, y, theta\), got"):
        LidarEnv(Navigate, **QUICK, initial_pose=wrong)
    env = LidarEnv(Navigate, **QUICK)
    with pytest.raises(ValueError, match="initial_pose must be"):
        env.reset(seed=0, options={"initial_pose": wrong})
    with pytest.raises(ValueError, match="outside the map"):
        env.reset(seed=0, options={"initial_pose": (99.0, 0.0, 0.0)})
    odometry = {**QUICK, "localizer": "odometry"}
    with pytest.raises(ValueError, match="needs localizer='amcl', got 'odometry'"):
        LidarEnv(Navigate, **odometry, initial_pose=(0.0, 0.0, 0.0))
    env = LidarEnv(Navigate, **odometry)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="needs localizer='amcl', got 'odometry'"):
        env.set_initial_pose((0.0, 0.0, 0.0))


def test_the_pose_estimate_is_set_during_an_episode():
    env = LidarEnv(Navigate, **QUICK, start=(-2.0, -0.5, 0.0))
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset"):
        env.set_initial_pose((0.0, 0.0, 0.0))
    env.reset(seed=0)
    for action in ([1.0, 0.0], [0.0, 1.0]):
        for _ in range(10):
            env.step(np.array(action, dtype=np.float32))
    before, truth = env.belief.pose, env.truths[0].state.pose
    for wrong in ((0.0, 1.0), (0.0, math.inf, 0.0), (99.0, 0.0, 0.0), "known", None):
        with pytest.raises(ValueError, match=r"must be|outside the map"):
            env.set_initial_pose(wrong)
        assert env.belief.pose == before
    env.set_initial_pose((truth.x + 0.4, truth.y, truth.theta + 0.2))
    assert env.belief.pose[:2] == pytest.approx((truth.x + 0.4, truth.y), abs=0.05)
    assert env.robots[0].predicted_pose == env.belief.pose
    for _ in range(60):
        info = env.step(np.array([0.0, 1.0], dtype=np.float32))[4]
    assert info["pose_error"][0] < 0.15
    env.set_initial_pose("unknown")
    assert env.belief.is_lost
    assert len(env.robots[0].estimator.particles) == 100_000
    for _ in range(100):
        info = env.step(np.array([0.3, 1.0], dtype=np.float32))[4]
    assert not info["is_lost"]
    assert info["pose_error"][0] < 0.15


def test_maps_of_explorations_begin_at_the_spawn():
    grid = OccupancyGrid(np.zeros((100, 100), dtype=np.int8), 0.05, (-2.5, -2.5))
    env = LidarEnv(Navigate, **TRUE, start=(-0.5, -0.5, 0.0), map=grid, map_pose="spawn")
    env.reset(seed=0)
    assert env.map_pose == env.world.spawns[0]
    assert env.map_pose[:2] == pytest.approx((-2.0, -0.5))
    assert tuple(env.belief.pose) == pytest.approx(tuple(env.map_pose.between(Pose2D(-0.5, -0.5, 0.0))))


@pytest.mark.parametrize(
    ("task", "method"), [("Sweep", "set_goal"), ("Explore", "set_goal"), ("Explore", "set_initial_pose")]
)
def test_tasks_without_goal_or_localizer_say_so(task, method):
    env = gymnasium.make(f"lidarnaut/{task}-v0", physics="kinematic").unwrapped
    env.reset(seed=0)
    with pytest.raises(ValueError, match=f"task {task} does not support {method}"):
        getattr(env, method)((0.0, 0.0, 0.0))
