"""The navigator on a known map: it gets there, and says why where it does not."""

import math

import numpy as np
import pytest

from baselines.episode import run_episode
from baselines.explorer import to_action
from baselines.navigation import GoalDriver, MapNavigator, MapNavigatorParams
from baselines.navigation.reactive_driving import ReactiveDriver
from envs.core import LidarEnv
from envs.estimation import Belief
from envs.geometry import OccupancyGrid, Pose2D
from envs.navigation import Navigator
from envs.navigation.local_planner import LOCAL_PLANNERS, make_local_planner
from envs.robots import load_robot
from envs.tasks.navigate import Navigate
from tests.baselines.maps import reading_of
from tests.navigation.costs import cost_at

BURGER = load_robot("turtlebot3_burger")
HERE = Pose2D(0.0, 0.0, 0.0)


def hall():
    """10 m x 4 m around the origin; a closed cell at its end; unknown beyond x = 4."""
    data = np.zeros((80, 200), dtype=np.int8)
    data[:, 180:] = -1
    data[[0, -1]] = data[:, [0, -1]] = 100
    data[:, 145:155] = 100
    return OccupancyGrid(data, 0.05, (-5.0, -2.0))


def navigator_in(grid, **params):
    return MapNavigator(BURGER, 0.1, grid, np.random.default_rng(0), MapNavigatorParams(**params))


def belief_at(pose, grid, *, lost=False):
    return Belief(pose, grid, is_lost=lost)


@pytest.mark.parametrize("planner", LOCAL_PLANNERS)
@pytest.mark.parametrize("physics", ["bullet", "kinematic"])
def test_goals_are_reached_with_amcl_in_the_loop(planner, physics):
    if physics == "bullet":
        pytest.importorskip("pybullet")
    env = LidarEnv(Navigate, world="turtlebot3_world", physics=physics)
    for seed in range(2):
        result = run_episode(env, GoalDriver(MapNavigatorParams(local_planner=planner)), seed)
        assert (result.end_reason, result.collisions) == ("reached", 0)
        assert result.path_length < 1.5 * result.course.of("geodesic_distance")[0] + 0.5
    env.close()


def test_same_seed_same_drive():
    env = LidarEnv(Navigate, world="turtlebot3_world", physics="kinematic")
    ends = [(d.duration, d.path_length) for d in (run_episode(env, GoalDriver(), 3), run_episode(env, GoalDriver(), 3))]
    assert ends[0] == ends[1]


def test_the_heading_asked_for_is_taken():
    env = LidarEnv(
        Navigate,
        world="turtlebot3_world",
        physics="kinematic",
        localizer="truth",
        start=(-2.0, -0.5, 0.0),
        goal=(-1.5, -0.5, 2.5),
        goal_tolerance=0.05,
        heading_tolerance=0.01,
    )
    env.reset(seed=0)
    navigator = MapNavigator(env.robot, env.control_period, env.belief.grid, np.random.default_rng(0))
    navigator.set_goal(env.task.goal[:2], env.task.goal.theta)
    for _ in range(300):
        if navigator.end_reason:
            break
        env.step(to_action(navigator.act(env.reading, env.belief), env.robot))
    assert navigator.end_reason == "reached"
    assert abs(env.belief.pose.theta - 2.5) < 0.2
    assert math.hypot(env.belief.pose.x + 1.5, env.belief.pose.y + 0.5) < 0.2


@pytest.mark.parametrize(
    ("goal", "problem"),
    [((2.52, 0.0), "in an obstacle"), ((4.5, 0.0), "in unknown space"), ((9.0, 0.0), "outside the map")],
)
def test_goals_that_are_not_traversable_are_refused_and_the_old_one_stays(goal, problem):
    navigator = navigator_in(hall())
    navigator.set_goal((1.0, 0.0))
    with pytest.raises(ValueError, match=problem):
        navigator.set_goal(goal)
    with pytest.raises(ValueError, match="heading"):
        navigator.set_goal((1.0, 0.5), math.nan)
    assert navigator.goal == (1.0, 0.0)


def test_without_a_path_it_says_so():
    navigator = navigator_in(hall())
    navigator.set_goal((3.0, 0.0))
    action = navigator.act(reading_of(), belief_at(HERE, hall()))
    assert navigator.end_reason == "no_path"
    assert action == (0.0, 0.0)


def test_a_path_through_the_unknown_is_taken_where_that_is_allowed():
    grid = hall()
    grid.data[1:-1, 145:155] = 0
    navigator = navigator_in(grid, allow_unknown=True)
    navigator.set_goal((4.5, 0.0))
    assert navigator.act(reading_of(), belief_at(HERE, grid))[0] > 0.0


def test_what_scans_find_is_driven_around():
    grid = hall()
    navigator = navigator_in(grid)
    navigator.set_goal((2.0, 0.0))
    reading = reading_of()
    reading.ranges[np.abs(BURGER.lidar.angles) < 0.15] = 1.0
    for _ in range(11):
        navigator.act(reading, belief_at(HERE, grid))
    obstacle = np.array([1.0 + BURGER.lidar.mount.x, 0.0])
    assert cost_at(navigator.layers.costmap, *obstacle) == 254
    assert np.hypot(*(navigator.plan - obstacle).T).min() > BURGER.radius


def test_a_robot_that_gets_nowhere_tries_everything_and_then_gives_up():
    navigator, grid, actions = navigator_in(hall()), hall(), []
    navigator.set_goal((2.0, 0.0))
    for _ in range(2000):
        actions.append(navigator.act(reading_of(), belief_at(HERE, grid)))
        if navigator.end_reason:
            break
    assert navigator.end_reason == "stuck"
    actions = np.array(actions)
    assert actions[:, 0].min() < 0.0
    # It spun for half a turn at least once.
    spun = (actions[:, 0] == 0.0) & (np.abs(actions[:, 1]) > 0.1)
    assert spun.sum() * 0.1 > math.pi


def test_a_bump_is_marked_and_left():
    navigator, grid = navigator_in(hall()), hall()
    navigator.set_goal((2.0, 0.0))
    assert navigator.act(reading_of(), belief_at(HERE, grid))[0] > 0.0
    assert navigator.act(reading_of(bumper=True), belief_at(HERE, grid))[0] < 0.0
    assert navigator.layers.num_marked > 0


def test_a_lost_robot_drives_by_the_scan_until_it_is_found():
    navigator, grid = navigator_in(hall()), hall()
    navigator.set_goal((-4.0, 0.0))
    ahead = navigator.act(reading_of(), belief_at(HERE, grid, lost=True))
    # The goal lies behind; the scan says that there is room ahead.
    assert ahead[0] > 0.0
    assert navigator.plan is None
    found = navigator.act(reading_of(), belief_at(HERE, grid))
    assert found[0] == 0.0
    assert found[1] != 0.0


def test_a_robot_that_stays_lost_says_so():
    navigator = navigator_in(hall(), lost_time=2.0)
    navigator.set_goal((2.0, 0.0))
    for _ in range(25):
        navigator.act(reading_of(), belief_at(HERE, hall(), lost=True))
    assert navigator.end_reason == "lost"


def test_scans_that_do_not_belong_to_the_map_end_lost():
    """On the map of another world AMCL reports that it is lost, and the navigator fails instead of driving anywhere."""
    other = LidarEnv(Navigate, world="turtlebot3_stage_4", physics="kinematic")
    other.reset(seed=0)
    env = LidarEnv(
        Navigate,
        world="turtlebot3_world",
        physics="kinematic",
        map=other.belief.grid,
        start=(-2.0, -0.5, 0.0),
        goal=(2.0, 0.5, 0.0),
    )
    assert run_episode(env, GoalDriver(MapNavigatorParams(lost_time=5.0)), 0).end_reason == "lost"


def test_blind_it_waits_and_then_gives_up():
    navigator, grid = navigator_in(hall(), blind_time=1.0), hall()
    navigator.set_goal((2.0, 0.0))
    for _ in range(9):
        assert navigator.act(reading_of(ranges=np.nan), belief_at(HERE, grid)) == (0.0, 0.0)
    assert navigator.act(reading_of(), belief_at(HERE, grid))[0] > 0.0
    for _ in range(12):
        navigator.act(reading_of(ranges=np.nan), belief_at(HERE, grid))
    assert navigator.end_reason == "blind"


def test_time_that_goes_backwards_is_refused():
    navigator, grid = navigator_in(hall()), hall()
    navigator.set_goal((2.0, 0.0))
    navigator.act(reading_of(time=0.5), belief_at(HERE, grid))
    with pytest.raises(ValueError, match="time went backwards"):
        navigator.act(reading_of(time=0.4), belief_at(HERE, grid))


def test_unknown_local_planners_are_named():
    with pytest.raises(ValueError, match=r"'teb'; allowed are rpp, dwb"):
        make_local_planner("teb", BURGER, 0.1)


def test_reactive_driving_covers_ground_without_contact():
    env = LidarEnv(Navigate, world="turtlebot3_world", physics="kinematic", localizer="truth", time_limit=120.0)
    for seed in range(2):
        env.reset(seed=seed, options={"goal": (-2.0, -0.5, 0.0)})
        navigator, driver = Navigator(env.robot, 0.1), ReactiveDriver(env.robot, 0.1, np.random.default_rng(seed))
        navigator.reset(env.reading)
        positions = []
        for _ in range(300):
            _, _, _, _, info = env.step(to_action(driver.command(navigator.obstacles), env.robot))
            navigator.sense(env.reading)
            positions.append(env.belief.pose[:2])
        assert info["collisions"] == 0
        assert info["path_length"] > 2.0
        assert np.ptp(positions, axis=0).max() > 1.0
