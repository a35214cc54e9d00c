import contextlib
import json
import math
import random
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage

from lidarnaut.driver.simulated_robot import SimulatedRobot
from lidarnaut.envs import robots
from lidarnaut.envs.logs import load_log, messages
from lidarnaut.envs.logs.transforms import seconds
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.worlds import load_map

pytest.importorskip("websockets")

from lidarnaut.driver import drive, serve
from lidarnaut.driver.rosbridge import Rosbridge, from_json, to_json
from lidarnaut.driver.server import RosbridgeServer

from .recorder import Recorder
from .sessions import Drive, Topics

SPEED = 4.0
SERVED = {"world": "turtlebot3_world", "robot": "turtlebot3_burger", "speed": SPEED}


def wait_for(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    assert condition()


@pytest.fixture
def broker():
    with contextlib.closing(RosbridgeServer()) as broker:
        yield broker


@contextlib.contextmanager
def running(broker, drive_options=(), **serve_options):
    """Run a simulated robot and a session that drives it, in threads of their own."""
    with contextlib.ExitStack() as held:
        bridges = [held.enter_context(contextlib.closing(Rosbridge(broker.url))) for _ in range(2)]
        server = serve.Server(serve.Options(url=broker.url, **SERVED, **serve_options), bridges[0])
        options = drive.Options(url=broker.url, use_sim_time=True, **{"policy": "pursuit", **dict(drive_options)})
        session = held.enter_context(contextlib.closing(drive.Session(options, bridges[1])))
        is_over = threading.Event()
        for work in (server.run, session.run):
            thread = threading.Thread(target=work, args=(is_over,), daemon=True)
            thread.start()
            held.callback(thread.join)
        held.callback(is_over.set)
        wait_for(lambda: session.driver is not None and session.driver.has_begun, 120.0)  # compiles kernels
        yield server, session


def test_the_clock_of_a_simulated_robot_begins_after_zero():
    sent = []
    bridge = SimpleNamespace(
        advertise=lambda *_, **__: None, subscribe=lambda *_: None, publish=lambda *each: sent.append(each)
    )
    server = serve.Server(serve.Options(**SERVED), bridge)
    for _ in range(11):
        server.step()
    headers = [one.header for _, m in sent for one in (getattr(m, "transforms", [m])) if hasattr(one, "header")]
    stamps = [seconds(message.clock) for topic, message in sent if topic == "/clock"]
    np.testing.assert_allclose(stamps, messages.RESET_STAMP + np.arange(11) / 50.0)
    assert {round(seconds(header.stamp), 6) for header in headers} == {round(stamp, 6) for stamp in stamps}
    scans = [seconds(message.header.stamp) for topic, message in sent if topic == "/scan"]
    np.testing.assert_allclose(scans, messages.RESET_STAMP + np.array([0.0, 0.1, 0.2]))


def error_of(server, session):
    x, y, _ = server.robot.start.compose(session.driver.belief.pose)
    return math.hypot(x - server.robot.pose.x, y - server.robot.pose.y)


def test_a_simulated_robot_is_driven_over_the_network_and_recorded(broker, tmp_path):
    saved = {"record": tmp_path / "drive.mcap", "save_map": tmp_path / "map.yaml"}
    with running(broker, {"lidar_from_messages": True, "imu_topic": "/imu"} | saved) as (server, session):
        begin = server.robot.time
        wait_for(lambda: server.robot.time > begin + 12.0, 60.0)
        assert session.driver.reason == ""
        assert (session.driver.belief.grid.data >= 0).sum() > 4000
        assert error_of(server, session) < 0.15
    log = load_log(tmp_path / "drive.mcap")
    assert len(log.ranges) > 30
    assert log.lidar.num_beams == 360
    assert (load_map(tmp_path / "map.yaml").data == 0).sum() > 1000


def test_a_lost_connection_stops_the_robot_for_a_while(broker):
    with running(broker) as (server, session):
        wait_for(lambda: session.reason == "")
        broker.close()
        wait_for(lambda: "connection" in session.reason)
        wait_for(lambda: max(map(abs, server.robot.twist)) < 0.05)
        with contextlib.closing(RosbridgeServer(broker.port)):
            wait_for(lambda: session.reason == "", 15.0)
            begin = server.robot.time
            wait_for(lambda: server.robot.time > begin + 5.0)
            assert error_of(server, session) < 0.15


def test_topics_of_a_namespace():
    received = []
    with contextlib.ExitStack() as held:
        server = held.enter_context(contextlib.closing(Recorder()))
        bridge = held.enter_context(contextlib.closing(Rosbridge(server.url, "/robot1/")))
        bridge.advertise("/odom", "nav_msgs/msg/Odometry")
        for topic in ("/goal_pose", "/clock"):
            bridge.subscribe(topic, "std_msgs/msg/Bool", lambda message, topic=topic: received.append(topic))
        wait_for(lambda: server._subscribers.keys() == {"/robot1/goal_pose", "/clock"})
        for topic in ("/goal_pose", "/robot1/goal_pose", "/clock"):
            server.publish(topic, {"data": True})
        wait_for(lambda: bridge.spin() or received == ["/goal_pose", "/clock"])
    assert server.advertised("/robot1/odom") == ["nav_msgs/Odometry"]


@pytest.mark.parametrize("from_messages", [False, True])
def test_the_lidar_may_be_mounted_upside_down(from_messages):
    robot = SimulatedRobot(rate=10.0)
    lidar = robot.robot.lidar
    static = messages.static_transforms(lidar.mount)
    rotation = static.transforms[1].transform.rotation  # half a turn around x, then 2 rad around z
    rotation.x, rotation.y, rotation.z, rotation.w = math.cos(1.0), math.sin(1.0), 0.0, 0.0
    run = Drive(static, robot=robot, lidar_from_messages=from_messages)
    for _ in range(30):
        sensed = run.sensed()
        sensed["/scan"].ranges, sensed["/scan"].angle_min = sensed["/scan"].ranges[::-1], 2.0 - lidar.angles[-1]
        run.step(sensed=sensed)
    belief, true = run.session.driver.belief, robot.start.between(robot.pose)
    assert math.dist(belief.pose[:2], true[:2]) < 0.05
    hit = np.isfinite(robot.reading.ranges)
    points = np.column_stack([np.cos(lidar.angles), np.sin(lidar.angles)])[hit] * robot.reading.ranges[hit, None]
    near_walls = ndimage.maximum_filter(belief.grid.data > 50, size=5)
    assert near_walls[tuple(belief.grid.cells(true.transform(points)).T)].mean() > 0.9


class Link(Topics):
    """Two ends that receive messages of each other, as JSON."""

    def __init__(self):
        super().__init__()
        self.receivers = {}

    def subscribe(self, topic, kind, receive):
        self.receivers.setdefault(topic, []).append(receive)

    def publish(self, topic, message):
        self.last[topic] = message
        for receive in self.receivers.get(topic, ()):
            receive(from_json(json.loads(json.dumps(to_json(message)))))


def served(robot, link, seconds, **options):
    """Drive a served robot for some time; return the session, and the errors of the estimated positions [m]."""
    session = drive.Session(drive.Options(policy="pursuit", use_sim_time=True, **options), link)
    server, errors = serve.Server(serve.Options(**{**SERVED, "world": "turtlebot3_house", "robot": robot}), link), []
    while server.robot.time < seconds:
        server.step()
        if round(50.0 * server.robot.time) % 5 == 0:
            session.step()
            if session.driver is not None and session.driver.has_begun:
                errors.append(error_of(server, session))
    return session, errors


@pytest.mark.parametrize("from_messages", [False, True])
def test_a_served_robot_with_a_lidar_that_spins_is_driven_as_well(from_messages, tmp_path, caplog):
    original = Path(robots.__file__).parent / "library" / "turtlebot3_burger.yaml"
    path = tmp_path / "spinning.yaml"
    path.write_text(original.read_text().replace("no_return: zero", "no_return: zero\n  scan_time: 0.18"))
    link = Link()
    _, errors = served(str(path), link, 12.0, lidar_from_messages=from_messages)
    assert max(errors) < 0.05
    scan = link.last["/scan"]
    assert scan.time_increment == pytest.approx(0.18 / 360)
    assert (scan.ranges == 0.0).mean() > 0.05
    assert not [one for one in caplog.records if one.levelname == "WARNING" and one.name.startswith("lidarnaut.driver")]


@pytest.mark.parametrize("increment", [math.nan, -0.1, 0.001])
def test_wrong_times_of_beams_are_ignored_with_a_warning(increment, caplog):
    run = Drive()
    robot, session = run.robot, run.session
    for k in range(10):
        scan = messages.laser_scan(robot.time, robot.reading.ranges, robot.robot.lidar, 0.1, increment if k else 0.0)
        run.publish(run.sensed() | {"/scan": scan})
        session.step()
        np.testing.assert_array_equal(session.driver.env.reading.ranges, robot.reading.ranges)
        robot.step(Twist(0.1, 0.5))
    warned = [record.message for record in caplog.records if "time_increment" in record.message]
    assert warned == [
        f"time_increment of scans is ignored: {increment:g} s for each of 360 beams, but 0.1 s between scans"
    ]


def damaged(message, rng):
    """Return a message with one field that is missing or of another kind."""
    data = json.loads(json.dumps(to_json(message)))
    owner, key = data, rng.choice([*data])
    while isinstance(owner[key], dict | list) and len(owner[key]) and rng.random() < 0.8:
        owner = owner[key]
        key = rng.choice([*owner]) if isinstance(owner, dict) else rng.randrange(len(owner))
    owner[key] = rng.choice([None, "x", -1, 1e300, math.nan, [], {}, True, -1e9, 0])
    if isinstance(owner, dict) and rng.random() < 0.1:
        del owner[key]
    return from_json(data)


@pytest.mark.parametrize("from_messages", [False, True])
def test_damaged_messages_are_dropped(from_messages):
    run, rng = Drive(robot=SimulatedRobot(rate=10.0), lidar_from_messages=from_messages), random.Random(0)
    robot, session = run.robot, run.session
    for k in range(150):
        for topic, message in run.sensed().items():
            run.topics.publish(topic, message)
            if 20 < k < 120 and rng.random() < 0.3:
                with contextlib.suppress(Exception):  # as in `Rosbridge`
                    run.topics.publish(topic, damaged(message, rng))
        command = session.step()
        assert all(map(math.isfinite, command))
        robot.step(command)
    assert session.reason == ""
    assert error_of(run, session) < 0.1


@pytest.mark.parametrize(("policy", "is_taken"), [("pursuit", True), ("learned:pretrained/reach", False)])
def test_a_goal_of_rviz_has_a_heading_for_policies_that_turn_to_it(policy, is_taken, caplog):
    if not is_taken:
        pytest.importorskip("torch")
    rotation = SimpleNamespace(x=0.0, y=0.0, z=math.sin(1.0), w=math.cos(1.0))
    pose = SimpleNamespace(position=SimpleNamespace(x=1.0, y=0.5), orientation=rotation)
    goal = SimpleNamespace(header=SimpleNamespace(frame_id="map"), pose=pose)
    session = drive.Session(drive.Options(policy=policy, goal=(0.0, 0.0)), Topics())
    session._on_goal(goal)
    task = session.driver.env.task
    assert tuple(task.goal) == pytest.approx((1.0, 0.5, 2.0 if is_taken else 0.0))
    assert task.heading_tolerance == (0.25 if is_taken else math.pi)
    assert ("that of the goal is ignored" in caplog.text) != is_taken


def test_messages_become_json_of_both_versions_of_ros():
    scan = messages.laser_scan(1.5, np.array([1.0, np.inf, np.nan], np.float32), SimulatedRobot().robot.lidar, 0.1)
    data = to_json(scan)
    assert data["ranges"] == [1.0, None, None]
    assert data["header"]["stamp"] == {"secs": 1, "nsecs": 500_000_000}
    for names in (("sec", "nanosec"), ("secs", "nsecs")):
        assert vars(from_json({"stamp": dict(zip(names, (1, 5)))}).stamp) == {"sec": 1, "nanosec": 5}
    points = to_json(messages.points(1.0, np.ones((2, 2))))
    assert "texture" not in points["markers"][0]
    assert points["markers"][0]["lifetime"] == {"secs": 2, "nsecs": 500_000_000}  # until the next ones


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"no_return": "0"}, "no_return must be 'inf', 'nan' or 'zero', got '0'"),
        ({"policy": "pursuitt"}, "unknown policy 'pursuitt'"),
        ({"policy": "mppi", "slam": "hectorr"}, "unknown SLAM 'hectorr'"),
        ({"robot": "nobody"}, "nobody"),
        ({"policy": "oracle"}, "uses ground truth"),
        ({"goal": (1.0,)}, "goal must be x, y, and optionally a heading"),
        ({"max_v": -1.0}, "max_v must be positive"),
        ({"save_map": Path("nowhere/map.yaml")}, "nowhere is not a folder"),
    ],
)
def test_wrong_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        drive.Session(drive.Options(**options), Topics())


def test_a_url_begins_with_a_protocol():
    with pytest.raises(ValueError, match="url must begin with ws://"):
        Rosbridge("http://localhost")
