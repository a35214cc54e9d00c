import dataclasses
import math

import numpy as np
import pytest

from lidarnaut.envs import navigation
from lidarnaut.envs.estimation import NO_UPDATE, Belief, Correction, MapUpdate
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D, Window
from lidarnaut.envs.navigation import FEATURES, NUM_SECTORS, FrontierNavigator, PlanningParams
from lidarnaut.envs.navigation.controllers.navigator_kernels import SPIN_RATE
from lidarnaut.envs.navigation.frontiers.frontier_navigator import RETRY_RADIUS, STILL_TIME
from lidarnaut.envs.navigation.frontiers.frontiers import frontier_mask
from tests.baselines.maps import reading_of
from tests.navigation.driving import moved
from tests.rooms import BURGER

PERIOD = 0.2
NARROW = dataclasses.replace(BURGER, lidar=dataclasses.replace(BURGER.lidar, fov=1.0))


def room(width=4.0, height=2.0, *, doors=((2.8, 3.6),)):
    """Known room with its corner at the origin; free cells beyond doors (x0, x1) in its upper wall meet the unknown."""
    data = np.full((round(height / 0.05) + 20, round(width / 0.05)), -1, dtype=np.int8)
    rows = round(height / 0.05)
    data[:rows] = 0
    data[:2] = data[rows - 2 : rows] = 100
    data[:rows, :2] = data[:rows, -2:] = 100
    for x0, x1 in doors:
        data[rows - 2 : rows + 4, round(x0 / 0.05) : round(x1 / 0.05)] = 0
    return data


CLOSED = np.where(room() < 0, 100, room()).astype(np.int8)
TURN = 2.0 * math.pi / SPIN_RATE


def offered(data, x, y, *, max_candidates=24, theta=0.0, **planning):
    navigator = FrontierNavigator(BURGER, PERIOD, max_candidates=max_candidates, planning=PlanningParams(**planning))
    navigator.begin(reading_of(), Belief(Pose2D(x, y, theta), OccupancyGrid(data, 0.05, (0.0, 0.0))))
    return navigator


def features_of(navigator, pose, num):
    arrays = [np.ones((num, size), dtype=np.float32) for size in (len(FEATURES), 2 * NUM_SECTORS, num)]
    navigator.write_features(pose, *arrays)
    return arrays


class Robot:
    """Robot in a room of 4 m x 2 m with one door; it is held in place or follows commands exactly."""

    def __init__(self, *, held=False, bumping=False, seconds=math.inf, max_time=60.0, data=None, robot=BURGER):
        grid = OccupancyGrid(room() if data is None else data, 0.05, (0.0, 0.0))
        self.belief = Belief(Pose2D(1.0, 1.0, 0.0), grid)
        self.navigator = FrontierNavigator(robot, PERIOD, max_candidates=5, max_time=max_time)
        self.navigator.begin(reading_of(), self.belief)
        self.time, self.commands = 0.0, []
        self._held, self._bumping, self._seconds = held, bumping, seconds

    def change(self, rows, cols, value):
        self.belief.grid.data[rows, cols] = value
        self.navigator.map.update(self.belief.grid, Window(0, 0, *self.belief.grid.data.shape))

    def decide(self, action=0):
        self.navigator.choose(action) if len(self.navigator.candidates) else self.navigator.look_around()
        return self.drive()

    def drive(self):
        outcome = None
        while outcome is None and self.time < self._seconds:
            twist = self.navigator.command(self.belief)
            self.commands.append(twist)
            self.belief.pose = moved(self.belief.pose, (0.0, 0.0) if self._held else twist, PERIOD)
            self.time += PERIOD
            outcome = self.navigator.update(reading_of(time=self.time, bumper=self._bumping), self.belief)
        return outcome


def test_candidates_are_the_frontiers_by_the_cost_of_their_paths():
    data = room(doors=((0.5, 1.3), (2.8, 3.6)))
    navigator = offered(data, 2.7, 1.0)
    found = navigator.candidates
    assert len(found) == 2
    assert found["frontier"][0, 0] > found["frontier"][1, 0]
    params = navigation.CostmapParams(BURGER.radius + 0.03, BURGER.radius + 0.48, 4.0)
    field = navigation.travel_field(navigation.make_costmap(navigator.map.grid, params), (2.7, 1.0))
    np.testing.assert_allclose(found["cost"], field.cost(navigator.map.grid.cells(found["viewpoint"])))
    cells = navigator.map.grid.cells(found["frontier"])
    assert frontier_mask(navigator.map.grid)[cells[:, 0], cells[:, 1]].all()
    assert (found["visible"] > 0.0).all()
    assert (found["unknown"] > 0.0).all()
    assert len(offered(data, 2.7, 1.0, max_candidates=1).candidates) == 1
    features, _, gaps = features_of(navigator, Pose2D(2.7, 1.0, 0.0), 3)
    distance = math.dist(*found["frontier"].tolist())
    share = distance / (distance + 5.0)
    np.testing.assert_allclose(gaps, [[0.0, share, 0.0], [share, 0.0, 0.0], [0.0, 0.0, 0.0]], rtol=1e-6)
    assert features[1, FEATURES.index("cost_ratio")] < 1.0


@pytest.mark.parametrize("seed", range(3))
def test_a_search_that_stops_early_finds_the_cheapest_of_all(seed):
    rng = np.random.default_rng(seed)
    data = np.zeros((400, 400), dtype=np.int8)
    for row, col in rng.integers(10, 390, (60, 2)):
        data[row : row + 3, col : col + int(rng.integers(5, 40))] = 100
    for row, col in rng.integers(10, 380, (40, 2)):
        data[row : row + 8, col : col + 8] = -1
    data[:2] = data[-2:] = data[:, :2] = data[:, -2:] = 100
    everything = offered(data, 10.0, 10.0, max_candidates=None).candidates
    few = offered(data, 10.0, 10.0, max_candidates=5).candidates
    assert len(everything) > 20
    np.testing.assert_array_equal(few["cost"], everything["cost"][:5])
    np.testing.assert_array_equal(few["viewpoint"], everything["viewpoint"][:5])


def test_long_frontiers_are_split_and_short_ones_wait():
    data = np.full((80, 200), -1, dtype=np.int8)
    data[:40] = 0
    data[:2] = 100
    data[:, :2] = data[:, -2:] = 100
    found = offered(data, 5.0, 1.0).candidates
    assert 4 <= len(found) <= 8
    assert len(set(found["group"].tolist())) == 1
    assert found["size"].sum() == pytest.approx(found["group_size"][0])
    x = np.sort(found["frontier"][:, 0])
    # Each part is represented by its middle cell nearest to the robot.
    assert np.diff(x).max() <= 2.0 + 1e-9
    assert np.ptp(x) >= 6.0
    small = room(doors=((0.5, 0.9),))
    assert len(offered(small, 2.0, 1.0, min_lengths=(10.0, 10.0)).candidates) == 0
    assert len(offered(small, 2.0, 1.0, min_lengths=(10.0, 0.2)).candidates) == 1


def test_gaps_that_only_a_smaller_robot_would_pass_come_last():
    # A wall ahead leaves a gap of 0.2 m; the frontier is too far behind it to be visible from here.
    data = room(height=4.0, doors=((1.5, 2.5),))
    data[30:32] = 100
    data[30:32, 38:42] = 0
    assert len(offered(data, 2.0, 0.5, tight_radii=()).candidates) == 0
    assert len(offered(data, 2.0, 0.5).candidates) == 1


def test_features_say_where_and_since_when():
    robot = Robot(held=True, max_time=4.0)
    assert [robot.decide() for _ in range(2)] == ["time_up"] * 2
    features, sectors, gaps = features_of(robot.navigator, robot.belief.pose, 5)
    named = dict(zip(FEATURES, features[0].tolist(), strict=True))
    x, y = robot.navigator.candidates["frontier"][0]
    assert named["ahead"] == pytest.approx((x - 1.0) / 16.0)
    assert named["left"] == pytest.approx((y - 1.0) / 16.0)
    assert named["age"] == pytest.approx(robot.time / (robot.time + 60.0))
    assert (named["chosen"], named["cost_ratio"], named["rank"]) == (1.0, 1.0, 0.0)
    assert 0.0 < named["turn"] < 0.5
    assert not any(rows.any() for rows in (features[1:], sectors[1:], gaps))
    np.testing.assert_array_equal(sectors[0], robot.navigator.candidates["sectors"][0])


def test_only_the_candidate_nearest_to_the_last_choice_is_marked():
    robot = Robot(held=True, max_time=2.0, data=room(doors=((1.0, 1.4), (1.6, 2.0), (3.0, 3.6))))
    assert [robot.decide(1) for _ in range(2)] == ["time_up"] * 2
    assert min(twist.v for twist in robot.commands) >= 0.0  # each drive may stand still for 3 s
    chosen = robot.navigator.target
    gaps = np.hypot(*(robot.navigator.candidates["frontier"] - chosen).T)
    assert robot.navigator.candidates.chosen == gaps.argmin()
    assert gaps.min() <= RETRY_RADIUS
    robot.navigator.fail()
    robot.navigator.find_candidates(reading_of(time=robot.time), robot.belief)
    assert robot.navigator.candidates.last_failed
    assert robot.navigator.candidates["failures"][gaps.argmin()] == 1


def test_a_robot_arrives_and_what_it_cannot_see_there_is_ignored():
    robot = Robot()
    assert len(robot.navigator.candidates) == 1
    viewpoint = robot.navigator.candidates["viewpoint"][0]
    assert robot.decide() == "arrived"
    assert math.dist(viewpoint, robot.belief.pose[:2]) <= 0.2
    # The map is unchanged: the only frontier is an unproductive goal.
    assert len(robot.navigator.map.ignored_points)
    assert len(robot.navigator.candidates) == 0
    assert robot.navigator.end_reason == "no_reachable_frontier"


def test_a_narrow_lidar_looks_around_before_a_frontier_is_ignored():
    turned = []
    for robot in (Robot(), Robot(robot=NARROW)):
        assert robot.decide() == "arrived"
        assert len(robot.navigator.map.ignored_points)
        looking = [k for k, twist in enumerate(robot.commands) if twist.v > 0.0][-1]
        turned.append(PERIOD * sum(abs(twist.w) for twist in robot.commands[looking + 1 :]))
    # Both turn once on the spot at the end, because no candidate is left.
    assert turned[0] == pytest.approx(2.0 * math.pi, abs=0.3)
    assert turned[1] > 4.0 * math.pi - NARROW.lidar.fov - 0.3


def test_a_look_around_ends_when_the_frontier_is_observed_and_nothing_is_ignored():
    robot = Robot(robot=NARROW, data=room(doors=((0.6, 1.4), (2.8, 3.6))))
    navigator = robot.navigator
    for _ in range(200):
        robot._seconds = robot.time + 0.5 * PERIOD
        robot.decide() if robot.time == 0.0 else robot.drive()
        if navigator.navigator.is_recovering:
            break
    robot.change(slice(38, 60), slice(0, 40), 100)
    robot._seconds = math.inf
    assert robot.drive() == "arrived"
    assert len(navigator.map.ignored_points) == 0
    assert len(navigator.candidates) == 1


def test_what_lies_behind_a_wall_is_not_ignored():
    data = room()
    # A wall to the right of the viewpoint in the door, and a nook with its own frontier.
    data[38:46, 66:74] = 100
    data[40:46, 68:74] = 0
    robot = Robot(data=data)
    assert robot.decide() == "arrived"
    assert len(robot.navigator.map.ignored_points)
    assert robot.navigator.map.ignored_points[:, 0].max() < 3.4


def test_a_robot_that_is_held_fails_backs_up_and_is_rid_of_what_it_fails_to_reach():
    robot = Robot(held=True)
    for failures in range(8):
        if len(robot.navigator.candidates) == 0:
            break
        if failures < 3:
            assert robot.navigator.candidates["failures"][0] == failures
            assert len(robot.navigator.map.ignored_points) == 0
        before = robot.time
        assert robot.decide() == "failed"
        assert robot.navigator.candidates.last_failed
        # Stuck for ten seconds, plus the recoveries in between.
        assert 9.0 < robot.time - before < 30.0
    assert min(twist.v for twist in robot.commands) < 0.0
    # The frontier is slightly longer than the part ignored after one failure.
    assert 3 <= failures < 8
    assert len(robot.navigator.candidates) == 0
    assert robot.navigator.end_reason == "stuck"


@pytest.mark.parametrize("inside", [0, 100])
def test_a_robot_enclosed_or_buried_by_obstacles_of_the_map_is_stuck(inside):
    data = room()
    data[12:29, 12:29] = 100
    data[13:28, 13:28] = inside
    robot = Robot(data=data)
    assert len(robot.navigator.candidates) == 0
    assert robot.decide() == "looked_around"
    assert robot.time < STILL_TIME
    assert robot.navigator.end_reason == "stuck"


def test_a_robot_in_an_obstacle_of_its_map_drives_out():
    data = room()
    data[17:23, 17:23] = 100
    robot = Robot(data=data)
    assert len(robot.navigator.candidates) == 0
    robot.decide()
    assert len(robot.navigator.candidates) == 1


def test_a_frontier_that_is_chosen_late_does_not_fail_at_once():
    robot = Robot(held=True, max_time=4.0)
    drives = [(robot.decide(), robot.time) for _ in range(4)]
    outcomes, times = zip(*drives)
    # Stuck after ten seconds, during the third drive or the recovery before.
    assert outcomes[:2] == ("time_up", "time_up")
    assert "failed" in outcomes
    assert np.diff([0.0, *times]).min() > 4.0 - PERIOD


@pytest.mark.parametrize(
    ("data", "is_bumping", "change", "outcome", "least", "most"),
    [
        (room(), False, (slice(None), slice(None), CLOSED), "frontier_gone", 1.0 + TURN, 1.0 + TURN + 3 * PERIOD),
        (room(), False, (slice(36, 38), slice(2, 78), 100), "failed", 4.0, 5.0 + 8.0),  # when it is planned anew
        (room(), True, None, "failed", 0.0, 20.0),
        (CLOSED, True, None, "looked_around", 0.0, 20.0),
    ],
)
def test_drives_end_when_frontiers_vanish_paths_close_or_bumps_go_on(data, is_bumping, change, outcome, least, most):
    robot = Robot(held=is_bumping, bumping=is_bumping, seconds=200.0, data=data)
    if change is not None:
        robot.change(*change)
    assert robot.decide() == outcome
    assert least - PERIOD <= robot.time <= most


def test_a_drive_goes_on_when_the_map_is_corrected():
    """Map and pose jump by 0.5 m and 90 degrees in the middle of a drive."""
    robot = Robot(seconds=2.0)
    navigator, belief = robot.navigator, robot.belief
    robot.decide()
    target, plan, goal = np.array(navigator.target), navigator.plan.copy(), np.array(navigator.navigator.goal)
    navigator._memory.failures = np.array([(3.2, 1.9), (0.5, 0.5)])
    navigator.map.ignore(np.array([(3.0, 2.1)]))
    ignored = navigator.map.ignored_points.copy()
    moved = Pose2D(0.5, 0.25, 0.5 * math.pi)
    before = np.array([(x, 1.0, 0.0) for x in (1.0, 2.0, 3.0)])
    after = np.array([moved.compose(Pose2D(*pose)) for pose in before])

    # A quarter turn takes column j to row j, and row i to the i-th column from the right.
    height = len(belief.grid.data)
    belief.grid.data = np.ascontiguousarray(belief.grid.data.T[:, ::-1])
    belief.grid.origin = (0.5 - 0.05 * height, 0.25)
    rows, cols = belief.grid.data.shape
    cells = np.argwhere(belief.grid.data >= 0).astype(np.int32)
    belief.update = MapUpdate(cells, Window(0, 0, rows, cols), True, belief.grid.origin, Correction(before, after))
    belief.pose = moved.compose(belief.pose)
    assert navigator.update(reading_of(time=robot.time), belief) is None
    belief.update = NO_UPDATE

    np.testing.assert_allclose(navigator.target, moved.transform(target[None])[0], atol=1e-9)
    np.testing.assert_allclose(navigator.navigator.goal, moved.transform(goal[None])[0], atol=1e-9)
    np.testing.assert_allclose(navigator.failures, moved.transform([(3.2, 1.9), (0.5, 0.5)]), atol=1e-9)
    np.testing.assert_allclose(navigator.map.ignored_points, moved.transform(ignored), atol=1e-9)
    # The new path ends at the end of the old path.
    np.testing.assert_allclose(navigator.plan[-1], moved.transform(plan[-1:])[0], atol=0.15)
    assert math.dist(navigator.plan[0], belief.pose[:2]) < 0.15
    robot._seconds = math.inf
    assert robot.drive() == "arrived"
    assert math.dist(belief.pose[:2], navigator.navigator.goal) < 0.3


def met_at_the_door():
    """Robot that has seen a person walk through its door; the map then shows the door as closed, with no path left."""
    robot = Robot(max_time=4.0)
    robot.belief.people = np.array([[2.2, 1.0, 0.0, 0.5, 0.25]])
    robot.navigator.look_around()
    robot._seconds = 0.5 * PERIOD
    robot.drive()
    robot.belief.people, robot._seconds = np.empty((0, 5)), math.inf
    robot.change(slice(38, 40), slice(56, 72), 100)
    return robot


def test_a_robot_that_has_met_people_goes_and_looks_again_before_it_gives_up():
    robot = met_at_the_door()
    robot._seconds = robot.time + 40.0
    assert robot.decide() is None
    assert math.dist(robot.belief.pose[:2], (3.2, 1.9)) < 0.8
    robot.change(slice(38, 40), slice(56, 72), 0)
    robot._seconds = math.inf
    assert robot.drive() is not None
    assert len(robot.navigator.candidates) == 1


def test_a_robot_gives_up_when_people_never_leave_and_at_once_when_there_were_none():
    robot = met_at_the_door()
    robot.decide()
    assert len(robot.navigator.candidates) == 0
    assert robot.navigator.end_reason in ("no_reachable_frontier", "stuck")
    assert 60.0 < robot.time < 300.0
    robot = Robot(max_time=4.0)
    robot.change(slice(38, 40), slice(56, 72), 100)
    robot.decide()
    assert robot.time < 30.0


def test_frontiers_given_up_among_people_are_offered_again():
    robot = Robot(held=True)
    robot.belief.people = np.array([[2.2, 1.0, 0.0, 0.0, 0.25]])
    assert [robot.decide() for _ in range(3)] == ["failed"] * 3
    assert len(robot.navigator.candidates) == 1


def test_obstacles_that_the_map_misses_are_planned_around_and_people_who_walk_are_not():
    data, ranges = room(8.0, 4.0, doors=()), np.full(BURGER.lidar.num_beams, np.inf, dtype=np.float32)
    ranges[np.abs(BURGER.lidar.angles) < 0.1] = 1.0
    data[40:60, 140:150] = -1
    obstacle = 3.0 + BURGER.lidar.mount.x, 2.5
    for speed, cost in ((0.0, 254), (0.8, 0)):
        belief = Belief(Pose2D(2.0, 2.5, 0.0), OccupancyGrid(data, 0.05, (0.0, 0.0)))
        belief.people = np.array([[1.15, 0.0, speed, 0.0, 0.25]])
        navigator = FrontierNavigator(BURGER, PERIOD)
        navigator.begin(reading_of(ranges=ranges), belief)
        navigator.look_around()
        navigator.update(reading_of(time=PERIOD, ranges=ranges), belief)
        navigator.look(reading_of(time=2 * PERIOD, ranges=ranges), belief)
        assert navigator.candidates.costmap.costs[navigator.map.cell(*obstacle)] == cost
        navigator.choose(0)
        assert (np.hypot(*(navigator.plan - obstacle).T).min() > BURGER.radius) == (speed == 0.0)
