import math
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.navigation import DockNavigator
from lidarnaut.envs.navigation.goals import docking
from lidarnaut.envs.navigation.goals.docking import DOCK_GAP, find_front
from lidarnaut.envs.tasks.dock import Dock, with_stations
from lidarnaut.envs.worlds import FixedRoute, load_world, rasterize
from tests.rollouts import play
from tests.rooms import make_room

STOP = np.zeros(2, dtype=np.float32)
WAREHOUSE = {"world": "tugbot_warehouse", "robot": "tugbot", "physics": "kinematic"}
HOUSE = {"world": "aws_small_house", "robot": "create3", "physics": "kinematic"}
DOCKED = {**WAREHOUSE, "localizer": "truth", "start": (14.65 - 0.369 - DOCK_GAP + 0.01, -10.6, 0.02)}


@pytest.mark.parametrize(("setting", "start"), [(WAREHOUSE, (12.0, -10.0, 2.0)), (HOUSE, (-4.0, -4.0, 0.0))])
@pytest.mark.parametrize("physics", ["kinematic", "bullet"])
def test_the_classic_policy_docks_without_contact(setting, start, physics):
    env = gymnasium.make("lidarnaut/Dock-v0", **setting | {"physics": physics, "start": start}).unwrapped
    episode = play(env, "dock")
    assert (episode.end_reason, episode.collisions) == ("docked", 0)
    assert episode.distance_to_goal <= 0.01
    assert episode.heading_error <= math.radians(3.0)
    dock, robot = env.world.docks[0], env.simulator.states[0].pose
    assert dock.between(robot).x == pytest.approx(-env.robot_params.radius - DOCK_GAP, abs=0.01)


@pytest.mark.parametrize(
    ("offset", "speed", "is_docked"),
    [
        ((0.0, 0.0, 0.0), 0.0, True),
        ((0.0, 0.019, 0.05), 0.0, True),
        ((0.0, 0.021, 0.0), 0.0, False),
        ((0.0, 0.0, 0.054), 0.0, False),
        ((0.0, 0.0, 0.0), 0.1, False),
    ],
)
def test_docked_means_two_centimetres_three_degrees_and_rest(offset, speed, is_docked):
    start = Pose2D(14.65 - 0.369 - DOCK_GAP, -10.6, 0.0).compose(Pose2D(*offset))
    env = LidarEnv(Dock, **DOCKED | {"start": start})
    env.reset(seed=0)
    _, reward, terminated, _, info = env.step(np.array([speed, 0.0], dtype=np.float32))
    assert (info["is_docked"], info["is_success"], terminated) == (is_docked,) * 3
    assert (reward > 9.0) == is_docked


def test_a_docked_robot_is_charged_up_to_the_target():
    env = LidarEnv(Dock, **DOCKED, start_charge=(0.5, 0.5), target_charge=0.5005)
    observation, _ = env.reset(seed=0)
    np.testing.assert_allclose(observation["battery"], [0.5, 0.0])
    battery, power = env.robot_params.battery, []
    for _ in range(100):
        before = env.task.charge
        observation, _, terminated, _, info = env.step(STOP)
        power.append((info["charge"] - before) * 3600.0 * battery.capacity / env.control_period)
        np.testing.assert_allclose(observation["battery"], [info["charge"], 1.0], rtol=1e-6)
        assert env.reading.extra["battery"][1] == 1.0
        if terminated:
            break
    assert power == pytest.approx([battery.charging_power] * len(power))
    assert info["end_reason"] == "docked"
    assert 0.5005 <= info["charge"] < 0.50051


def test_the_policy_stays_at_the_station_until_the_battery_is_charged():
    env = LidarEnv(Dock, **DOCKED | {"start": (13.0, -10.6, 0.0)}, start_charge=(0.5, 0.5), target_charge=0.5003)
    episode = play(env, "dock")
    docked = episode.history.of("is_docked")
    assert episode.end_reason == "docked"
    assert docked[docked.argmax() :].all()
    assert docked.sum() > 30


def test_the_time_limit_includes_charging():
    env = LidarEnv(Dock, **DOCKED, target_charge=0.8)
    env.reset(seed=0)
    battery, without = env.robot_params.battery, LidarEnv(Dock, **DOCKED)
    without.reset(seed=0)
    charging = 3600.0 * 0.8 * battery.capacity / battery.charging_power
    assert env.time_limit - without.time_limit == pytest.approx(charging, abs=10.0)


@pytest.mark.parametrize(("min_distance", "expected"), [(1.0, {5.7, 1.0}), (3.0, {5.7}), (100.0, {5.7})])
def test_a_random_dock_is_not_near_if_another_is_far(min_distance, expected):
    docks = Pose2D(5.9, 2.0, 0.0), Pose2D(1.0, 3.9, 0.5 * math.pi)
    world = replace(make_room(0.0, 0.0, 6.0, 4.0, spawn=Pose2D(1.0, 1.0, 0.0)), docks=docks)
    settings = {"world": world, "start": "spawn", "physics": "kinematic", "localizer": "truth"}
    env, found = LidarEnv(Dock, **settings, min_distance=min_distance), set()
    for seed in range(8):
        env.reset(seed=seed)
        found.add(round(env.task.goal.x, 1))
    assert found == expected


def test_an_empty_battery_ends_the_episode():
    env = LidarEnv(Dock, **WAREHOUSE, start=(12.0, -10.0, 0.0), start_charge=(2e-4, 2e-4))
    env.reset(seed=0)
    info, charges = {}, []
    while "end_reason" not in info:
        info = env.step(np.array([0.5, 0.0], dtype=np.float32))[4]
        charges.append(info["charge"])
    assert (info["end_reason"], info["charge"], info["is_success"]) == ("empty", 0.0, False)
    power = 3600.0 * env.robot_params.battery.capacity * (charges[6] - charges[7]) / env.control_period
    battery = env.robot_params.battery
    assert power == pytest.approx(battery.idle_power + 0.39 * battery.energy_per_metre, rel=0.05)


STATION = {"start": (4.2, 2.5, 0.0), "physics": "kinematic", "robot": "create3"}


def square(x, y, half=0.1):
    """Return the sides of a bag."""
    corners = [(x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)]
    return [(*a, *b) for a, b in zip(corners, corners[1:] + corners[:1])]


def lot(segments=(), people=(), x=5.9):
    """Return a room with a dock at (x, 2.5), and a map of it without the further segments and people."""
    empty = replace(make_room(0.0, 0.0, 6.0, 5.0, spawn=Pose2D(1.0, 1.0, 0.0)), docks=(Pose2D(x, 2.5, 0.0),))
    world = replace(empty, segments=np.vstack([empty.segments, *segments]), people=tuple(people))
    return {"world": world, "map": rasterize(with_stations(empty), 0.05)}


@pytest.mark.parametrize(
    ("physics", "bag"), [("kinematic", (5.2, 2.6)), ("kinematic", (5.1, 2.36)), ("bullet", (5.2, 2.5))]
)
def test_an_unmapped_bag_before_the_station_is_not_touched(bag, physics, monkeypatch):
    monkeypatch.setattr(docking, "BLOCKED_TIME", 4.0)
    env = LidarEnv(Dock, **STATION | {"physics": physics}, **lot([square(*bag)]))
    episode = play(env, "dock")
    assert (episode.end_reason, episode.collisions) == ("blocked", 0)
    assert 4.0 * 4.0 < episode.duration < episode.time_limit


NICHE = [[(4.6, y, 6.0, y)] for y in (2.29, 2.71)]
DOCKS = {
    "a bag at the staging pose": ({"start": (3.0, 1.0, 0.0)}, {"segments": [square(4.73, 2.5)]}),
    "a bag beside the path": ({"start": (3.0, 1.0, 0.0)}, {"segments": [square(5.4, 2.2)]}),
    "a niche": ({}, {"segments": NICHE}),
    "a flat station": ({}, {"x": 5.98}),
    "a flat station, a small robot": ({"robot": "raspimouse"}, {"x": 5.94}),
}


@pytest.mark.parametrize("case", DOCKS)
def test_the_policy_docks_past_obstacles_and_at_stations_that_hardly_stand_out(case):
    arguments, room = DOCKS[case]
    episode = play(LidarEnv(Dock, **STATION | arguments, **lot(**room)), "dock")
    assert (episode.end_reason, episode.collisions) == ("docked", 0)
    assert episode.duration < 60.0


def test_the_robot_waits_for_a_person_who_walks_through():
    person = FixedRoute(0.25, np.array([(5.2, 2.1), (5.2, 4.5), (0.5, 4.5)]), 0.1)
    durations = []
    for people in ((), (person,)):
        episode = play(LidarEnv(Dock, **STATION, **lot(people=people)), "dock")
        assert (episode.end_reason, episode.collisions) == ("docked", 0)
        durations.append(episode.duration)
    assert durations[1] > durations[0] + 3.0


BAG_BEHIND = {**STATION, "start": (5.2, 2.5, 0.0), **lot([square(4.78, 2.5)])}


@pytest.mark.parametrize(
    ("arguments", "least_path"), [(BAG_BEHIND, 0.0), (DOCKED | {"start": (13.0, -10.6, 0.0)}, 3.6)]
)
def test_the_policy_backs_off_up_to_a_bag_and_gives_up_without_a_charging_current(arguments, least_path, monkeypatch):
    monkeypatch.setattr(Dock, "_is_at_goal", lambda task: False)
    episode = play(LidarEnv(Dock, **arguments), "dock")
    assert (episode.end_reason, episode.collisions) == ("not_charging", 0)
    assert least_path < episode.path_length < 10.0


def test_a_contact_while_backing_off_is_remembered_behind_the_robot():
    env = LidarEnv(Dock, **STATION, **lot())
    env.reset(seed=0)
    navigator = DockNavigator()
    navigator.reset(env.robot_params, env.control_period, np.random.default_rng(0))
    navigator.set_goal(env.task.goal)
    navigator.act(env.reading, env.belief)
    navigator._to_dock, navigator._is_backing = Pose2D(0.2, 0.0, 0.0), True
    assert navigator.act(env.reading, env.belief).v < 0.0
    assert navigator.act(env.reading._replace(bumper=True), env.belief) == (0.0, 0.0)
    assert navigator._navigator.record["forward"] == 0
    touched = navigator._navigator.obstacles[: navigator._navigator.record["num_remembered"]]
    assert len(touched) == 5
    assert (touched[:, 0] < 0.0).all()


@pytest.mark.parametrize("pose", [Pose2D(1.2, 0.1, 0.1), Pose2D(1.0, -0.15, -0.2)])
def test_the_front_of_a_station_is_found_among_other_points(pose):
    front = pose.transform(np.column_stack([np.zeros(40), np.linspace(-0.15, 0.15, 40)]))
    wall = pose._replace(x=pose.x + 0.1).transform(np.column_stack([np.zeros(61), np.linspace(-1.5, 1.5, 61)]))
    points = np.vstack([wall[:27], front, wall[34:]])
    found, width = find_front(points, pose.compose(Pose2D(0.05, -0.1, 0.1)))
    assert tuple(found) == pytest.approx(tuple(pose), abs=1e-6)
    assert width == pytest.approx(0.3)
    assert find_front(points, pose.compose(Pose2D(0.0, -0.5, 0.0))) is None
    assert find_front(wall, pose) is None  # too wide
    assert find_front(np.empty((0, 2)), pose) is None


def wall_with_station(depth, noise, rng, distance=0.9):
    """Return the points of a scan, one per degree, of a wall with a station 0.3 m wide that stands out by `depth`."""
    bearings = np.radians(np.arange(-80.0, 80.0))
    front, wall = distance / np.cos(bearings), (distance + depth) / np.cos(bearings)
    ranges = np.where(np.abs(front * np.sin(bearings)) < 0.15, front, wall) + noise * rng.standard_normal(160)
    return (ranges * np.array([np.cos(bearings), np.sin(bearings)])).T


@pytest.mark.parametrize(
    ("depth", "noise"), [(0.03, 0.01), (0.04, 0.01), (0.06, 0.01), (0.1, 0.01), (0.06, 0.03), (0.1, 0.03), (0.15, 0.03)]
)
def test_a_station_stands_out_from_a_wall_by_little_more_than_the_noise(depth, noise):
    rng, expected, offsets = np.random.default_rng(1), Pose2D(0.85, 0.05, 0.05), []
    for _ in range(20):
        found = find_front(wall_with_station(depth, noise, rng), expected)
        offsets += [] if found is None else [found[0][:2]]
        assert find_front(wall_with_station(0.0, noise, rng), expected) is None
    assert len(offsets) >= 15
    assert np.median(offsets, axis=0) == pytest.approx([0.9, 0.0], abs=0.01)


def test_stations_are_solid_and_need_docks():
    world = load_world("aws_small_house")
    assert len(with_stations(world).segments) == len(world.segments) + 4
    assert with_stations(world) is with_stations(world)
    with pytest.raises(ValueError, match="'turtlebot3_world' has no docks; choose tugbot_warehouse, aws_small_house"):
        LidarEnv(Dock, world="turtlebot3_world", physics="kinematic").reset(seed=0)
    env = LidarEnv(Dock, world="turtlebot3_world", physics="kinematic", goal=(-0.55, -0.5, 0.0))
    assert env.reset(seed=0)[1]["charge"] > 0.0
