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
from lidarnaut.envs.navigation.goals.goal_navigator import LOCAL_PLANNERS
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.tasks.navigate import Navigate
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from tests.baselines.maps import reading_of
from tests.navigation.costs import cost_at

BURGER = load_robot("turtlebot3_burger")
HERE = Pose2D(0.0, 0.0, 0.0)
TRUE = {"world": "turtlebot3_world", "physics": "kinematic", "localizer": "truth"}


def hall():
    """Hall of 10 m x 4 m around the origin with a closed cell at its end; unknown beyond x = 4."""
    data = np.zeros((80, 200), dtype=np.int8)
    data[:, 180:] = -1
    data[[0, -1]] = data[:, [0, -1]] = 100
    data[:, 145:155] = 100
    return OccupancyGrid(data, 0.05, (-5.0, -2.0))


def navigator_to(goal, **params):
    navigator = GoalNavigator(GoalParams(**params))
    navigator.reset(BURGER, 0.1, np.random.default_rng(0))
    navigator.set_goal(goal)
    return navigator


@pytest.mark.parametrize("planner", LOCAL_PLANNERS)
@pytest.mark.parametrize("physics", ["bullet", "kinematic"])
def test_goals_are_reached_with_amcl_in_the_loop(planner, physics):
    if physics == "bullet":
        pytest.importorskip("pybullet")
    env = LidarEnv(Navigate, world="turtlebot3_world", physics=physics)
    for seed in range(2):
        result = run_episode(env, GoalNavigator(GoalParams(local_planner=planner)), seed)
        assert (result.end_reason, result.collisions) == ("reached", 0)
        assert result.path_length < 1.5 * result.history.of("geodesic_distance")[0] + 0.5
    again = run_episode(env, GoalNavigator(GoalParams(local_planner=planner)), seed)
    assert (again.duration, again.path_length) == (result.duration, result.path_length)
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


def test_the_heading_asked_for_is_taken():
    ends = {"start": (-2.0, -0.5, 0.0), "goal": (-1.5, -0.5, 2.5), "goal_tolerance": 0.05, "heading_tolerance": 0.01}
    env = LidarEnv(Navigate, world="turtlebot3_world", physics="kinematic", localizer="truth", **ends)
    env.reset(seed=0)
    navigator = GoalNavigator()
    navigator.reset(env.robot, env.control_period, np.random.default_rng(0))
    navigator.set_goal(env.task.goal[:2], env.task.goal.theta)
    for _ in range(300):
        if navigator.end_reason:
            break
        env.step(to_action(navigator.act(env.reading, env.belief), env.robot))
    assert navigator.end_reason == "arrived"
    assert abs(env.belief.pose.theta - 2.5) < 0.2
    assert math.hypot(env.belief.pose.x + 1.5, env.belief.pose.y + 0.5) < 0.2


def test_a_corridor_hardly_wider_than_the_robot_is_passed_without_contact(tmp_path):
    world = tmp_path / "corridor.yaml"
    hall, half = [(0, -1), (-3, -1), (-3, 1), (0, 1)], 0.26
    corners = [*hall, (0, half), (2, half), (2, 1), (4, 1), (4, -1), (2, -1), (2, -half), (0, -half), hall[0]]
    rows = ", ".join(f"[{x}, {y}]" for x, y in corners)
    world.write_text(f"source: test\nlicence: MIT\nspawns: [[-1, 0, 0]]\npolylines: [[{rows}]]\n")
    ends = {"start": (-1.5, 0.3, 1.0), "goal": (3.0, 0.4, 0.0)}
    env = LidarEnv(
        Navigate, world=str(world), robot="turtlebot3_waffle_pi", physics="kinematic", localizer="truth", **ends
    )
    result = run_episode(env, GoalNavigator(), 0)
    assert (result.end_reason, result.collisions) == ("reached", 0)


@pytest.mark.parametrize("goal", [(3.0, 0.0), (2.52, 0.0), (4.5, 0.0), (9.0, 0.0)])
def test_goals_behind_walls_in_them_in_unknown_space_and_off_the_map_have_no_path(goal):
    navigator = navigator_to(goal)
    assert navigator.act(reading_of(), Belief(HERE, hall())) == (0.0, 0.0)
    assert navigator.end_reason == "no_path"


@pytest.mark.parametrize(("planner", "size"), [("rpp", 1.0), ("dwb", 0.2), ("mppi", 0.5)])
def test_a_robot_that_starts_in_an_obstacle_of_the_map_drives_out_where_the_scan_is_free(size, planner):
    x, y = -2.0, -0.5
    first = LidarEnv(Navigate, **TRUE, start=(x, y, 0.0), goal=(-0.5, 0.5, 0.0))
    first.reset(seed=0)
    grid = first.belief.grid
    centers = grid.centers(np.argwhere(np.ones_like(grid.data)))
    grid.data[(np.abs(centers - (x, y)).max(axis=1) < 0.5 * size).reshape(grid.data.shape)] = 100
    env = LidarEnv(Navigate, **TRUE, start=(x, y, 0.0), goal=(-0.5, 0.5, 0.0), map=grid)
    result = run_episode(env, GoalNavigator(GoalParams(local_planner=planner)), 0)
    assert (result.end_reason, result.collisions) == ("reached", 0)


def test_what_blocks_a_path_is_logged(caplog):
    grid, wall = hall(), reading_of(ranges=0.3)
    for goal, text in (
        (2.52, "goal (2.52, 0.00) is in an obstacle of the map"),
        (4.5, "in unknown space"),
        (9.0, "off"),
    ):
        caplog.clear()
        navigator_to((goal, 0.0)).act(reading_of(), Belief(HERE, grid))
        assert text in caplog.text
    grid.data[30:50, 90:110] = 100
    navigator = navigator_to((2.0, 0.0))
    navigator.act(wall, Belief(HERE, grid))
    assert navigator.end_reason == "no_path"
    assert "start (0.00, 0.00) is in an obstacle of the map" in caplog.text
    assert "goal" not in caplog.text.split("start")[1]


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
    navigator, pose, twist = navigator_to((2.0, 0.0), local_planner=planner), HERE, (0.0, 0.0)
    for k in range(400):
        is_held = k < 80  # and turned, with the bumper pressed in eight headings
        moved = (0.0, 0.1) if is_held else (0.1 * twist[0], 0.1 * twist[1])
        pose = pose.compose(Pose2D(moved[0], 0.0, moved[1]))
        twist = navigator.act(reading_of(time=0.1 * k, bumper=is_held and k % 10 < 5), Belief(pose, hall()))
        if navigator.end_reason:
            break
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
    navigator, grid = navigator_to((-4.0, 0.0)), hall()
    ahead = navigator.act(reading_of(), Belief(HERE, grid, is_lost=True))
    # The goal is behind; the scan shows free space ahead.
    assert ahead[0] > 0.0
    assert navigator.plan is None
    found = navigator.act(reading_of(), Belief(HERE, grid))
    assert found[0] == 0.0
    assert found[1] != 0.0


def test_scans_that_do_not_belong_to_the_map_end_lost():
    """On the map of another world AMCL reports that it is lost: the navigator has to fail without driving."""
    other = LidarEnv(Navigate, world="turtlebot3_stage_4", physics="kinematic")
    other.reset(seed=0)
    ends = {"start": (-2.0, -0.5, 0.0), "goal": (2.0, 0.5, 0.0)}
    env = LidarEnv(Navigate, world="turtlebot3_world", physics="kinematic", map=other.belief.grid, **ends)
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


def test_dwb_gets_the_heading_of_the_goal_and_turns_by_its_own_critic():
    navigator = navigator_to((2.0, 0.0), local_planner="dwb")
    navigator.set_tolerances(0.2, 0.4)
    navigator.set_goal((2.0, 0.0, 2.0))
    pose, twist, turned = HERE, Twist(0.0, 0.0), []
    for k in range(400):
        twist = navigator.act(reading_of(time=0.1 * k), Belief(pose, hall()))
        pose = pose.compose(Pose2D(0.1 * twist.v, 0.0, 0.1 * twist.w))
        if math.dist(pose[:2], (2.0, 0.0)) < 0.1:
            turned.append(twist)
        if navigator.end_reason:
            break
    planner = navigator._planner
    assert (planner._heading, planner._tolerance) == (2.0, 0.1)
    assert navigator.end_reason == "arrived"
    assert abs(pose.theta - 2.0) < 0.2
    # The critic brakes first, and then turns on the spot.
    assert all(one.v == 0.0 for one in turned if abs(one.w) > 0.5)


def test_parameters_of_dwb_are_those_of_dwb_only():
    navigator = GoalNavigator(GoalParams(local_planner="dwb"), dwb=DwbParams(max_vel_x=0.1))
    navigator.reset(BURGER, 0.1, np.random.default_rng(0))
    navigator.set_goal((2.0, 0.0))
    assert 0.05 < navigator.act(reading_of(), Belief(HERE, hall())).v <= 0.1
    commands = []
    for max_vel_x in (0.1, math.inf):
        navigator = GoalNavigator(GoalParams(local_planner="mppi"), dwb=DwbParams(max_vel_x=max_vel_x))
        navigator.reset(BURGER, 0.1, np.random.default_rng(0))
        navigator.set_goal((2.0, 0.0))
        commands.append(navigator.act(reading_of(), Belief(HERE, hall())))
    assert commands[0] == commands[1] != (0.0, 0.0)
