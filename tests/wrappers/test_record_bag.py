import itertools
import math
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.logs import load_log
from lidarnaut.envs.logs.messages import RESET_STAMP, static_transforms
from lidarnaut.envs.navigation import crop_to_known
from lidarnaut.envs.robots import Mount
from lidarnaut.envs.wrappers import BagRecorder, RecordBag

QUICK = {"world": "turtlebot3_world", "physics": "kinematic", "time_limit": 2.5}
FIELDS = {
    "/clock": ("rosgraph_msgs/msg/Clock", "clock"),
    "/scan": (
        "sensor_msgs/msg/LaserScan",
        "header angle_min angle_max angle_increment time_increment scan_time range_min range_max ranges intensities",
    ),
    "/odom": ("nav_msgs/msg/Odometry", "header child_frame_id pose twist"),
    "/tf": ("tf2_msgs/msg/TFMessage", "transforms"),
    "/tf_static": ("tf2_msgs/msg/TFMessage", "transforms"),
    "/map": ("nav_msgs/msg/OccupancyGrid", "header info data"),
    "/plan": ("nav_msgs/msg/Path", "header poses"),
    "/cmd_vel": ("geometry_msgs/msg/TwistStamped", "header twist"),
}


def make(id="lidarnaut/Explore-v0", **arguments):
    return gymnasium.make(id, **QUICK | arguments)


def drive(env, seed=0):
    env.reset(seed=seed)
    readings, done = [env.unwrapped.reading], False
    while not done:
        env.unwrapped.overlay.plan = np.array([[0.0, 0.0], [1.0, len(readings)]])
        *_, terminated, truncated, _ = env.step(np.array([0.8, 0.3], dtype=np.float32))
        readings.append(env.unwrapped.reading)
        done = terminated or truncated
    return readings


def read(path):
    messages = {}
    with AnyReader([path]) as reader:
        for connection, time, raw in reader.messages():
            messages.setdefault(connection.topic, []).append((time, reader.deserialize(raw, connection.msgtype)))
    return messages


def pose(transform):
    move, turn = transform.translation, transform.rotation
    assert (turn.x, turn.y) == (0.0, 0.0)
    return Pose2D(move.x, move.y, 2 * math.atan2(turn.z, turn.w))


@pytest.fixture
def drive_recorded(tmp_path):
    def record(**arguments):
        with RecordBag(make(**arguments), tmp_path) as env:
            return env.unwrapped, drive(env), tmp_path / "episode_0.mcap"

    return record


@pytest.mark.parametrize("slam", ["tinyslam", "truth"])
def test_a_bag_gives_the_readings_back(drive_recorded, slam):
    env, readings, bag = drive_recorded(slam=slam)
    log, lidar = load_log(bag), env.robot_params.lidar
    np.testing.assert_array_equal(log.ranges, [reading.ranges for reading in readings])
    np.testing.assert_allclose(log.times, [RESET_STAMP + reading.time for reading in readings], atol=1e-9)
    np.testing.assert_array_equal(log.scan_rows, np.arange(len(readings)))
    np.testing.assert_allclose(log.odometry, [reading.odometry for reading in readings], atol=1e-9)
    np.testing.assert_allclose(log.lidar.directions, lidar.directions, atol=1e-5)
    assert (log.lidar.mount.x, log.lidar.mount.z) == (lidar.mount.x, lidar.mount.z)
    assert log.lidar.range_max == pytest.approx(lidar.range_max)


def test_frames_maps_plans_and_commands(drive_recorded):
    env, readings, bag = drive_recorded()
    belief, robot, steps, messages = env.belief, env.robot_params, len(readings) - 1, read(bag)
    counts = {topic: len(found) for topic, found in messages.items()}
    each = dict.fromkeys(("/clock", "/scan", "/odom", "/tf"), steps + 1)
    assert counts == each | {"/tf_static": 1, "/map": 4, "/plan": steps, "/cmd_vel": steps}
    start = round(RESET_STAMP * 10**9)
    assert [time - start for time, _ in messages["/map"]] == [0, 10**9, 2 * 10**9, 25 * 10**8]
    for (time, _), (_, clock) in zip(messages["/scan"], messages["/clock"]):
        assert clock.clock.sec * 10**9 + clock.clock.nanosec == time

    map_odom, odom_base = messages["/tf"][-1][1].transforms
    link, laser = messages["/tf_static"][0][1].transforms
    frames = [(one.header.frame_id, one.child_frame_id) for one in (map_odom, odom_base, link, laser)]
    chain = ["map", "odom", "base_footprint", "base_link", "laser"]
    assert frames == list(itertools.pairwise(chain))
    assert laser.transform.translation.z == robot.lidar.mount.z
    np.testing.assert_allclose(pose(map_odom.transform).compose(pose(odom_base.transform)), belief.pose, atol=1e-9)
    odometry = messages["/odom"][-1][1]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("odom", "base_footprint")
    assert odometry.pose.pose.position.x == odom_base.transform.translation.x
    assert odometry.twist.twist.linear.x == pytest.approx(0.8 * robot.max_v, rel=0.1)
    for topic, frame in (("/scan", "laser"), ("/map", "map"), ("/plan", "map")):
        assert messages[topic][0][1].header.frame_id == frame

    grid, known = messages["/map"][-1][1], crop_to_known(belief.grid, margin=0)
    np.testing.assert_array_equal(grid.data.reshape(grid.info.height, grid.info.width), known.data)
    assert (grid.info.origin.position.x, grid.info.origin.position.y) == known.origin
    assert grid.info.resolution == pytest.approx(known.resolution)
    time, command = messages["/cmd_vel"][0]
    assert time == start
    assert (command.twist.linear.x, command.twist.angular.z) == pytest.approx((0.8 * robot.max_v, 0.3 * robot.max_w))
    plan = messages["/plan"][2][1]
    assert [(p.pose.position.x, p.pose.position.y) for p in plan.poses] == [(0.0, 0.0), (1.0, 3.0)]


def stamps(value):
    """Yield all time stamps of a message in seconds."""
    if hasattr(value, "nanosec"):
        yield value.sec + 1e-9 * value.nanosec
        return
    parts = value if isinstance(value, list) else vars(value).values() if hasattr(value, "__msgtype__") else ()
    for part in parts:
        yield from stamps(part)


def test_messages_are_those_of_ros_2_and_maps_and_static_transforms_are_latched(drive_recorded):
    with AnyReader([drive_recorded()[2]]) as reader:
        found = {c.topic: (c.msgtype, c.msgdef.data) for c in reader.connections}
        latched = {c.topic for c in reader.connections for q in c.ext.offered_qos_profiles if q.durability.value == 1}
    assert latched == {"/map", "/tf_static"}
    assert found.keys() == FIELDS.keys()
    stores = [get_typestore(store) for store in (Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY, Stores.LATEST)]
    for topic, (kind, fields) in FIELDS.items():
        assert found[topic][0] == kind
        own = found[topic][1].split("=" * 80)[0]
        lines = [line.split("#")[0].split() for line in own.splitlines()]
        assert [line[1] for line in lines if len(line) == 2] == fields.split()
        assert len({store.hash_rihs01(kind) for store in stores}) == 1


def test_each_episode_has_a_bag_which_is_whole_or_absent(tmp_path):
    env = RecordBag(make(), tmp_path)
    drive(env, seed=0)
    env.reset(seed=1)
    env.step(np.zeros(2, dtype=np.float32))
    assert [path.name for path in tmp_path.glob("*.mcap")] == ["episode_0.mcap"]
    env.reset(seed=2)  # ends the second episode early
    assert len(read(tmp_path / "episode_1.mcap")["/scan"]) == 2
    with pytest.raises(ValueError, match="action must be finite"):
        env.step(np.full(2, np.nan, dtype=np.float32))
    env.close()
    env.close()
    assert len(read(tmp_path / "episode_2.mcap")["/scan"]) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"episode_{k}.mcap" for k in range(3)]


def test_a_recorder_leaves_nothing_after_an_exception(tmp_path):
    env = make()

    def interrupted():
        with BagRecorder(env, tmp_path / "drive.mcap"):
            env.reset(seed=0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    with BagRecorder(env, tmp_path / "drive.mcap"):
        pass
    assert list(tmp_path.iterdir()) == []
    with BagRecorder(env, tmp_path / "drive.mcap") as recorder:
        env.reset(seed=0)
        with pytest.raises(RuntimeError, match="a bag holds one episode"):
            env.reset(seed=1)
        recorder.close()
        env.reset(seed=1)
    assert len(read(tmp_path / "drive.mcap")["/scan"]) == 1


def test_what_cannot_be_recorded_is_refused(tmp_path):
    with pytest.raises(TypeError, match="is not a LidarEnv"):
        RecordBag(gymnasium.make("CartPole-v1"), tmp_path).reset()
    with pytest.raises(ValueError, match="bags support one robot, the environment has 2"):
        BagRecorder(make("lidarnaut/ExploreTeam-v0", num_robots=2), tmp_path / "team.mcap")
    env = make()
    with pytest.raises(ValueError, match=r"bags are written as \.mcap"):
        BagRecorder(env, tmp_path / "drive.bag")
    with BagRecorder(env, tmp_path / "drive.mcap"), pytest.raises(ValueError, match="being recorded already"):
        BagRecorder(env, tmp_path / "other.mcap")


def test_sensors_of_the_users_own_have_topics(drive_recorded):
    sensor = SimpleNamespace(name="level", shape=(2,), reset=lambda *_: None, measure=lambda *_: np.array([1.0, 2.5]))
    _, readings, bag = drive_recorded(sensors=[sensor])
    messages = [message for _, message in read(bag)["/sensors/level"]]
    assert [message.data.tolist() for message in messages] == [[1.0, 2.5]] * len(readings)
    assert messages[0].layout.dim[0].size == 2


def test_people_and_tracks_are_markers_that_are_shown_for_half_a_second(tmp_path):
    env = make(world="turtlebot3_stage_4")
    with BagRecorder(env, tmp_path / "people.mcap"):
        env.reset(seed=0)
        for tracks in (np.array([[1.0, 0.5, 0.3, 0.4, 0.25]]), np.empty((0, 5))):
            env.unwrapped.overlay.tracks = tracks
            env.step(np.zeros(2, dtype=np.float32))
        inner = env.unwrapped
        truth = inner.map_pose.inverse().transform(inner.simulator.people[:, :2])
    messages, lifetime = read(tmp_path / "people.mcap"), 0.5
    for topic, found in messages.items():  # tf2 takes the stamp 0 for the latest
        for time, message in found:
            own = [stamp for stamp in stamps(message) if stamp != lifetime]
            assert min(time / 10**9, *own, math.inf) >= RESET_STAMP, topic
    people = messages["/ground_truth/people"][-1][1].markers
    at = [(marker.pose.position.x, marker.pose.position.y) for marker in people if marker.type == marker.CYLINDER]
    np.testing.assert_allclose(at, truth)
    [(_, tracks)] = messages["/tracks"]
    cylinder, arrow = tracks.markers
    assert (cylinder.pose.position.x, cylinder.pose.position.y, cylinder.scale.x) == (1.0, 0.5, 0.5)
    assert (arrow.points[1].x, arrow.points[1].y) == pytest.approx((1.3, 0.9))
    assert {(marker.lifetime.sec, marker.lifetime.nanosec) for marker in (cylinder, arrow)} == {(0, 500_000_000)}


def test_a_tilted_lidar_is_tilted_in_static_transforms():
    mount = Mount(0.1, -0.2, 0.3, yaw=2.5, pitch=0.2, roll=-0.1)
    transform = static_transforms(mount).transforms[1].transform
    move, turn = transform.translation, transform.rotation
    assert (move.x, move.y, move.z) == (0.1, -0.2, 0.3)
    expected = Rotation.from_euler("xyz", [-0.1, 0.2, 2.5]).as_matrix()
    np.testing.assert_allclose(Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix(), expected, atol=1e-12)
