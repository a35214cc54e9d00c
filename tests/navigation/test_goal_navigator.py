import math

import numpy as np
import pytest

from lidarnaut.baselines.episode import run_episode
from lidarnaut.baselines.policy import to_action
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.navigation import DwbParams, GoalNavigator, GoalParams, Navigator
from lidarnaut.envs.navigation.controllers.reactive_driving import ReactiveDriver
from lidarnaut.envs.navigation.goals.goal_navigator import local_planners
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.tasks.navigate import Navigate
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from tests.baselines.maps import reading_of
from tests.navigation.driving import cost_at, moved
from tests.rooms import BURGER, make_room
from tests.rooms import ORIGIN as HERE

TRUE = {"physics": "kinematic", "localizer": "truth"}


def hall():
    """Hall of 10 m x 4 m around the origin with a closed cell at its end; unknown beyond x = 4."""
    data = np.zeros((80, 200), dtype=np.int8)
    data[:, 180:] = -1
    data[[0, -1]] = data[:, [0, -1]] = 100
    data[:, 145:155] = 100
    return OccupancyGrid(data, 0.05, (-5.0, -2.0))


def navigator_to(goal, dwb=DwbParams(), **params):  # noqa: B008
    navigator = GoalNavigator(GoalParams(**params), dwb=dwb)
    navigator.reset(BURGER, 0.1, np.random.default_rng(0))
    navigator.set_goal(goal)
    return navigator


def drive(navigator, is_bumped=lambda k: False, is_held=lambda k: False):
    """Follow commands exactly in the hall until the navigator ends; yield poses and commands."""
    pose, twist = HERE, Twist(0.0, 0.0)
    for k in range(400):
        pose = moved(pose, (0.0, 1.0) if is_held(k) else twist)
        twist = navigator.act(reading_of(time=0.1 * k, bumper=is_bumped(k)), Belief(pose, hall()))
        yield pose, twist
        if navigator.end_reason:
            break


@pytest.mark.parametrize(
    ("planner", "physics"), [*((name, "kinematic") for name in local_planners()), ("rpp", "bullet"), ("mppi", "bullet")]
)
def test_goals_are_reached_with_amcl_in_the_loop(planner, physics):
    if physics == "bullet":
        pytest.importorskip("pybullet")
    env = LidarEnv(Navigate, world="turtlebot3_world", physics=physics)
    for seed in range(2):
        result = run_episode(env, GoalNavigator(GoalParams(local_planner=planner)), seed)
        assert (result.end_reason, result.collisions) == ("reached", 0)
        assert result.path_length < 1.5 * result.history.of("geodesic_distance")[0] + 0.5
    env.close()


class Crawler:
    """Local planner without a base class."""

    def __init__(self, robot, control_period, rng):
        self.robot = robot

    def command(self, pose, twist, obstacles):
        assert len(self.tracks) == 0
        return Twist(0.1 * self.robot.max_v, 0.0)


def test_a_local_planner_of_ones_own_needs_only_commands():
    navigator = navigator_to((1.0, 0.0), local_planner=f"{__name__}:Crawler")
    assert navigator.act(reading_of(), Belief(HERE, hall())) == (0.1 * BURGER.max_v, 0.0)
    assert len(navigator.plan) > 5


@pytest.mark.parametrize("planner", ["rpp", "dwb", "mppi"])
def test_the_heading_of_the_goal_is_taken(planner):
    navigator = navigator_to((2.0, 0.0), local_planner=planner)
    navigator.set_tolerances(0.2, 0.4)
    navigator.set_goal((2.0, 0.0, 2.5))
    steps = list(drive(navigator))
    pose = steps[-1][0]
    assert navigator.end_reason == "arrived"
    assert abs(pose.theta - 2.5) < 0.2
    assert math.dist(pose[:2], (2.0, 0.0)) < 0.2
    navigator.set_tolerances(0.1, math.pi)
    navigator.set_goal((2.0, 0.0, 2.5))
    assert (navigator._attempt.heading, navigator._tolerance) == (None, navigator.params.goal_tolerance)
    if planner == "dwb":
        assert (navigator._planner._heading, navigator._planner._tolerance) == (2.5, 0.1)
        # Its critic brakes first, and then turns on the spot.
        turned = [twist for pose, twist in steps if math.dist(pose[:2], (2.0, 0.0)) < 0.1]
        assert all(one.v == 0.0 for one in turned if abs(one.w) > 0.5)


def test_a_corridor_hardly_wider_than_the_robot_is_passed_without_contact():
    sides = [[0, y, 2, y] for y in (-0.26, 0.26)]
    doors = [[x, sign * 0.26, x, sign] for x in (0, 2) for sign in (-1, 1)]
    ends = {"world": make_room(-3, -1, 4, 1, sides + doors), "start": (-1.5, 0.3, 1.0), "goal": (3.0, 0.4, 0.0)}
    result = run_episode(LidarEnv(Navigate, **TRUE, **ends, robot="turtlebot3_waffle_pi"), GoalNavigator(), 0)
    assert (result.end_reason, result.collisions) == ("reached", 0)


@pytest.mark.parametrize(("planner", "size"), [("rpp", 1.0), ("dwb", 0.2), ("mppi", 0.5)])
def test_a_robot_that_starts_in_an_obstacle_of_the_map_drives_out_where_the_scan_is_free(planner, size):
    ends = {**TRUE, "world": "turtlebot3_world", "start": (-2.0, -0.5, 0.0), "goal": (-0.5, 0.5, 0.0)}
    first = LidarEnv(Navigate, **ends)
    first.reset(seed=0)
    grid = first.belief.grid
    corners = np.array([[-2.0 - 0.5 * size, -0.5 - 0.5 * size], [-2.0 + 0.5 * size, -0.5 + 0.5 * size]])
    rows, cols = grid.cells(corners).T
    grid.data[slice(*rows), slice(*cols)] = 100
    result = run_episode(LidarEnv(Navigate, **ends, map=grid), GoalNavigator(GoalParams(local_planner=planner)), 0)
    assert (result.end_reason, result.collisions) == ("reached", 0)


@pytest.mark.parametrize(
    ("x", "box", "cause"),
    [
        (3.0, 0, "goal: no gap between obstacles of the map is wide enough"),
        (2.52, 0, "goal: goal (2.52, 0.00) is in an obstacle of the map"),
        (4.5, 0, "goal: goal (4.50, 0.00) is in unknown space"),
        (9.0, 0, "goal: goal (9.00, 0.00) is off the map"),
        (2.0, 10, "goal: start (0.00, 0.00) is in an obstacle of the map"),
    ],
)
def test_what_blocks_a_path_is_logged(caplog, x, box, cause):
    grid, navigator = hall(), navigator_to((x, 0.0))
    grid.data[40 - box : 40 + box, 100 - box : 100 + box] = 100
    assert navigator.act(reading_of(ranges=0.3 if box else np.inf), Belief(HERE, grid)) == (0.0, 0.0)
    assert navigator.end_reason == "no_path"
    assert caplog.text.rstrip().endswith(cause)


def test_goals_that_are_not_finite_are_refused_and_the_old_one_stays():
    navigator = navigator_to((1.0, 0.0))
    for goal, heading in (((1.0, 0.5), math.nan), ((math.inf, 0.0), None)):
        with pytest.raises(ValueError, match="finite"):
            navigator.set_goal(goal, heading)
        assert navigator.goal == (1.0, 0.0)
    with pytest.raises(ValueError, match=r"'teb'; allowed are rpp, rpp:fast, dwb, mppi"):
        navigator_to((1.0, 0.0), local_planner="teb")


def test_a_robot_that_may_search_again_looks_around_first():
    navigator, turned = navigator_to((3.0, 0.0), max_searches=2), 0.0
    while navigator.end_reason is None:
        turned += 0.1 * navigator.act(reading_of(), Belief(HERE, hall())).w
    assert navigator.end_reason == "no_path"
    assert turned == pytest.approx(2.0 * math.pi, abs=0.2)


def test_a_path_through_the_unknown_is_taken_where_that_is_allowed():
    grid = hall()
    grid.data[1:-1, 145:155] = 0
    assert navigator_to((4.5, 0.0), allow_unknown=True).act(reading_of(), Belief(HERE, grid)).v > 0.0
    # On a growing map the path is valid, also outside of the map.
    grid.data[1:-1, -1] = -1
    growing = Belief(HERE, grid, grows=True)
    navigator = navigator_to((6.0, 0.0))
    assert navigator.act(reading_of(), growing).v > 0.0
    np.testing.assert_allclose(navigator.plan[-1], (6.0, 0.0), atol=0.1)


@pytest.mark.parametrize("gap", [0, 1])
def test_a_gap_too_narrow_for_the_robot_is_looked_at_on_a_map_that_grows_where_there_is_no_other_path(gap):
    grid = hall()
    grid.data[1:-1, 146:] = 0
    grid.data[40 : 40 + gap, 145] = 0
    grid.data[:, -1] = grid.data[0] = grid.data[-1] = 100
    growing = Belief(HERE, grid, grows=True)
    navigator = navigator_to((4.0, 0.0))
    for _ in range(4):
        navigator.act(reading_of(), growing)
    assert navigator.end_reason == (None if gap else "no_path")


def unknown(pose=HERE):
    """Belief of dead reckoning, without a map."""
    blank = OccupancyGrid(np.full((1, 1), -1, dtype=np.int8), 0.05, (0.0, 0.0))
    return Belief(pose, blank, grows=True)


def test_without_a_map_planning_cells_follow_robot_and_goal_and_reach_farther_where_there_is_no_path():
    navigator = navigator_to((2.0, 0.0))
    assert navigator.act(reading_of(), unknown()).v > 0.0
    y = np.arange(-4.4, 4.4, 0.05)
    navigator.map.mark(np.column_stack([np.full_like(y, 1.0), y]))
    wall, ahead = reading_of(), np.cos(BURGER.lidar.angles)
    wall.ranges[ahead > 0.25] = (1.0 - BURGER.lidar.mount.x) / ahead[ahead > 0.25]
    belief = unknown()
    for _ in range(9):
        navigator.act(wall, belief)
    assert navigator.end_reason is None
    assert np.abs(navigator.plan[:, 1]).max() > 3.1
    far = unknown(Pose2D(30.0, 0.0, 0.0))
    navigator.set_goal((33.0, 0.0))
    assert navigator.act(reading_of(), far).v > 0.0
    np.testing.assert_allclose(navigator.plan[-1], (33.0, 0.0), atol=0.1)


def test_goals_among_cylinders_are_reached_by_odometry():
    env = LidarEnv(ReachGoal, world="barn:6", physics="kinematic", start="spawn", goal="world", goal_tolerance=1.0)
    result = run_episode(env, GoalNavigator(GoalParams(local_planner="rpp:fast")), 0)
    assert result.end_reason == "reached"
    assert result.barn_metric > 0.45


def test_a_bump_is_left_and_remembered_also_when_the_map_grows():
    navigator, grid = navigator_to((2.0, 0.0)), hall()
    assert navigator.act(reading_of(), Belief(HERE, grid)).v > 0.0
    assert navigator.act(reading_of(bumper=True), Belief(HERE, grid)).v < 0.0
    marked = navigator.map.grid.centers(np.argwhere(navigator.map.marks == 100))
    assert len(marked) > 0
    larger = OccupancyGrid(np.pad(grid.data, ((9, 0), (21, 3)), constant_values=-1), 0.05, (-6.05, -2.45))
    navigator.act(reading_of(), Belief(HERE, larger))
    found = navigator.map.grid.centers(np.argwhere(navigator.map.marks == 100))
    np.testing.assert_allclose(found, marked, atol=1e-6)


@pytest.mark.parametrize("planner", ["rpp", "dwb", "mppi"])
def test_a_robot_that_was_turned_in_contact_drives_on_once_it_is_free(planner):
    """The robot is held for 8 s and turned, with the bumper pressed in eight headings."""
    navigator = navigator_to((2.0, 0.0), local_planner=planner)
    list(drive(navigator, is_bumped=lambda k: k < 80 and k % 10 < 5, is_held=lambda k: k < 80))
    assert navigator.end_reason == "arrived"


def test_what_scans_find_is_driven_around():
    grid = hall()
    navigator = navigator_to((2.0, 0.0))
    reading = reading_of()
    reading.ranges[np.abs(BURGER.lidar.angles) < 0.15] = 1.0
    for _ in range(11):
        navigator.act(reading, Belief(HERE, grid))
    obstacle = np.array([1.0 + BURGER.lidar.mount.x, 0.0])
    assert cost_at(navigator.map.costmap(0, HERE), *obstacle) == 254
    assert np.hypot(*(navigator.plan - obstacle).T).min() > BURGER.radius


def test_a_robot_that_is_told_to_looks_for_the_goal_around_where_it_has_arrived():
    navigator, reached, pose = navigator_to((-2.0, 0.0), search_radius=0.8), set(), Pose2D(-2.0, 0.0, 0.0)
    while navigator.end_reason is None:
        navigator.act(reading_of(), Belief(pose, hall()))
        reached.add(navigator.target)
        pose = Pose2D(*navigator.target, 0.0)
    x, y = np.array(sorted(reached)).T
    assert navigator.goal == (-2.0, 0.0)
    assert navigator.end_reason == "arrived"
    true = np.array([(r * math.cos(a) - 2.0, r * math.sin(a)) for r in (0.3, 0.6, 0.9) for a in range(7)])
    assert np.hypot(x - true[:, :1], y - true[:, 1:]).min(axis=1).max() < 0.3


def test_people_block_no_path_until_the_robot_has_got_nowhere_among_them():
    navigator, belief = navigator_to((2.0, 0.0)), Belief(HERE, hall())
    reading, belief.on_people = reading_of(), np.abs(BURGER.lidar.angles) < 0.15
    reading.ranges[belief.on_people] = 1.0
    costs = []
    for k in range(300):
        navigator.act(reading._replace(time=0.1 * k), belief)
        costs.append(cost_at(navigator.map.costmap(0, HERE), 1.0 + BURGER.lidar.mount.x, 0.0))
    assert max(costs[:90]) < 253
    assert max(costs) == 254


def test_a_robot_that_gets_nowhere_tries_everything_and_then_gives_up():
    navigator, grid, actions = navigator_to((2.0, 0.0)), hall(), []
    for _ in range(2000):
        actions.append(navigator.act(reading_of(), Belief(HERE, grid)))
        if navigator.end_reason:
            break
    assert navigator.end_reason == "stuck"
    actions = np.array(actions)
    assert actions[:, 0].min() < 0.0
    spun = (actions[:, 0] == 0.0) & (np.abs(actions[:, 1]) > 0.1)
    assert spun.sum() * 0.1 > math.pi


def test_a_lost_robot_drives_by_the_scan_until_it_is_found():
    navigator, grid = navigator_to((-4.0, 0.0), lost_patience=1.0), hall()
    ahead = navigator.act(reading_of(), Belief(HERE, grid, is_lost=True))
    # The goal is behind; the scan shows free space ahead.
    assert ahead[0] > 0.0
    assert navigator.plan is None
    found = navigator.act(reading_of(), Belief(HERE, grid))
    assert found[0] == 0.0
    assert found[1] != 0.0
    for k in range(15):  # a robot that was localized before is patient
        navigator.act(reading_of(), Belief(HERE, grid, is_lost=True))
        assert k in (8, 9, 10) or (navigator.plan is None) == (k > 10)


def test_scans_that_do_not_belong_to_the_map_end_lost():
    """On the map of another world AMCL reports that it is lost: the navigator has to fail without driving."""
    other = LidarEnv(Navigate, world="turtlebot3_stage_4", physics="kinematic")
    other.reset(seed=0)
    ends = {"map": other.belief.grid, "start": (-2.0, -0.5, 0.0), "goal": (2.0, 0.5, 0.0)}
    env = LidarEnv(Navigate, world="turtlebot3_world", physics="kinematic", **ends)
    assert run_episode(env, GoalNavigator(GoalParams(lost_time=5.0)), 0).end_reason == "lost"


def test_blind_it_waits_and_then_gives_up():
    navigator, grid = navigator_to((2.0, 0.0), blind_time=1.0), hall()
    for _ in range(9):
        assert navigator.act(reading_of(ranges=np.nan), Belief(HERE, grid)) == (0.0, 0.0)
    assert navigator.act(reading_of(), Belief(HERE, grid))[0] > 0.0
    for _ in range(12):
        navigator.act(reading_of(ranges=np.nan), Belief(HERE, grid))
    assert navigator.end_reason == "blind"


def test_time_that_goes_backwards_is_refused():
    navigator, grid = navigator_to((2.0, 0.0)), hall()
    navigator.act(reading_of(time=0.5), Belief(HERE, grid))
    with pytest.raises(ValueError, match="time went backwards"):
        navigator.act(reading_of(time=0.4), Belief(HERE, grid))


def test_reactive_driving_covers_ground_without_contact():
    env = LidarEnv(Navigate, **TRUE, world="turtlebot3_world", time_limit=120.0)
    env.reset(seed=1, options={"goal": (-2.0, -0.5, 0.0)})
    navigator = Navigator(env.robot_params, 0.1)
    driver = ReactiveDriver(env.robot_params, 0.1, np.random.default_rng(1))
    navigator.sense(env.reading)
    positions = []
    for _ in range(300):
        _, _, _, _, info = env.step(to_action(driver.command(navigator.obstacles), env.robot_params))
        navigator.sense(env.reading)
        positions.append(env.belief.pose[:2])
    assert info["collisions"] == 0
    assert info["path_length"] > 2.0
    assert np.ptp(positions, axis=0).max() > 1.0


def test_parameters_of_dwb_are_those_of_dwb_only():
    def first_command(planner, max_vel_x):
        navigator = navigator_to((2.0, 0.0), DwbParams(max_vel_x=max_vel_x), local_planner=planner)
        return navigator.act(reading_of(), Belief(HERE, hall()))

    assert 0.05 < first_command("dwb", 0.1).v <= 0.1
    assert first_command("mppi", 0.1) == first_command("mppi", math.inf) != (0.0, 0.0)
