import logging
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.logs import messages
from lidarnaut.envs.logs.transforms import seconds
from lidarnaut.envs.robots import LidarParams, Mount

pytest.importorskip("websockets")

from lidarnaut.driver import drive
from lidarnaut.driver.frames import MAX_TRANSFORMS, MAX_WAITING, WAIT_FOR_TRANSFORM, WAIT_FOR_TREE, Frames

from .sessions import Drive, Topics

LIDAR = LidarParams(num_beams=4, range_min=0.1, range_max=3.5, fov=1.5, mount=Mount(x=0.4, y=0.1, z=0.2, yaw=0.3))
YAML_MOUNT = (0.4, 0.1, 0.3)
NEVER = 1e9


def frames_of(**options):
    return Frames(drive.Options(**options), LIDAR)


def edge(parent, child, x=0.0, y=0.0, yaw=0.0, *, time=0.0, euler=None):
    """Return a message with a transform; `euler`: roll, pitch and yaw [rad]."""
    message = messages.transforms(time, (parent, child, Pose2D(0.0, y, yaw)))
    message.transforms[0].transform.translation.x = x
    if euler is not None:
        q = message.transforms[0].transform.rotation
        q.x, q.y, q.z, q.w = Rotation.from_euler("xyz", euler).as_quat().tolist()
    return message


def scan_of(frame="laser", time=1.0, **fields):
    scan = messages.laser_scan(time, np.array([1.0, 2.0, 3.0, 3.0], np.float32), LIDAR, 0.1)
    scan.header.frame_id = frame
    for name, value in fields.items():
        setattr(scan, name, value)
    return scan


def imu_of(*rates, frame="imu"):
    message = messages.imu(1.0, 0.0)
    message.header.frame_id = frame
    message.angular_velocity = SimpleNamespace(**dict(zip("xyz", rates)))
    return message


def mounts_of(scans):
    """Return x, y and yaw of the lidar at each scan."""
    return [(*scan.position[:2], scan.first - LIDAR.angle_min) for scan in scans]


def odometry(frames, child="base_link", now=0.0):
    return frames.base_pose(child, Pose2D(1.0, 2.0, math.pi / 2), now)


def frames_with(*edges, child="base_link", static=True, **options):
    """Return frames with transforms, and with odometry of a child frame."""
    frames = frames_of(**options)
    for each in edges:
        frames.add(each, static=static)
    odometry(frames, child)
    return frames


def mount_by(*edges, frame="laser", **how):
    """Return x, y and yaw of the lidar by some transforms; None while the scan waits."""
    frames = frames_with(*edges, **how)
    frames.receive(scan_of(frame))
    return next(iter(mounts_of(frames.placed(0.0))), None)


LASER = edge("base_link", "laser", 0.2, 0.0, 1.5)


@pytest.mark.parametrize(
    ("edges", "how", "expected"),
    [
        ([LASER], {}, (0.2, 0.0, 1.5)),
        ([edge("/base_link", "/laser", 0.2, 0.0, 1.5)], {"child": "/base_link", "frame": "/laser"}, (0.2, 0.0, 1.5)),
        ([edge("a/base", "a/laser", 0.2, 0.0, 1.5)], {"child": "a/base", "frame": "a/laser"}, (0.2, 0.0, 1.5)),
        ([edge("base_footprint", "base_link", 0.1), LASER], {"child": "base_footprint"}, (0.3, 0.0, 1.5)),
        ([edge("base_link", "base_footprint", 0.1), LASER], {"child": "base_footprint"}, (0.1, 0.0, 1.5)),
        ([edge("base_footprint", "base_link", 0.1), LASER], {"base_frame": "/base_link"}, (0.2, 0.0, 1.5)),
        ([edge("base_footprint", "base_link", 0.1), LASER], {"child": ""}, (0.3, 0.0, 1.5)),
        ([LASER], {"child": ""}, (0.2, 0.0, 1.5)),
        ([LASER], {"child": None}, (0.2, 0.0, 1.5)),
        ([edge("base_link", "laser", 5.0), LASER], {}, (0.2, 0.0, 1.5)),  # sent again with another value
        ([edge("base_link", "laser", 0.2, time=k) for k in range(3)], {"static": False}, (0.2, 0.0, 0.0)),  # ROS 1
        ([], {"frame": "base_link"}, (0.0, 0.0, 0.0)),
        ([LASER], {"lidar_from_robot": True}, YAML_MOUNT),
        ([LASER], {"frame": "", "laser_frame": "laser"}, (0.2, 0.0, 1.5)),
        ([LASER], {"child": "base_footprint"}, None),
        ([LASER], {"frame": "lidar"}, None),
        ([LASER], {"frame": "a/laser"}, None),
        ([LASER], {"frame": ""}, None),
        ([LASER], {"child": "", "base_frame": "base"}, None),
        ([edge("base_link", "laser", math.nan)], {}, None),
        ([edge("odom", "base_link", 3.0), edge("odom", "laser")], {"static": False}, None),  # moves with the robot
    ],
)
def test_the_lidar_is_placed_by_the_transforms_between_the_frames_of_odometry_and_scans(edges, how, expected):
    found = mount_by(*edges, **how)
    assert found == (None if expected is None else pytest.approx(expected))


def test_scans_wait_for_their_transform_and_the_newest_are_kept(caplog):
    frames = frames_of()
    frames.add(edge("base_footprint", "base_link", 0.1), static=True)
    times = [0.1 * k for k in range(MAX_WAITING + 5)]
    for k, time in enumerate(times):
        frames.receive(scan_of(time=time))
        if k == 3:
            assert "odometry" in frames.explain("no scan yet")
            odometry(frames, "base_footprint")
        assert frames.placed(time) == []
    assert frames.explain("no scan yet") == "no scan yet (scans wait for a transform from 'base_footprint' to 'laser')"
    assert frames.explain("/enable is not true") == "/enable is not true"
    frames.add(LASER, static=True)
    scans = frames.placed(times[-1])
    assert [scan.time for scan in scans] == pytest.approx(times[-MAX_WAITING:])
    np.testing.assert_allclose(mounts_of(scans), [(0.3, 0.0, 1.5)] * MAX_WAITING)
    assert frames.placed(times[-1]) == []
    assert frames.explain("no scan yet") == "no scan yet"
    assert not caplog.records


def test_a_missing_transform_is_named_once_after_five_seconds_of_the_robots_clock(caplog):
    frames = frames_with(edge("odom", "base_link"), static=False, laser_frame="rear")
    frames.receive(scan_of("rear"))
    for now in (0.0, WAIT_FOR_TRANSFORM):
        assert frames.placed(now) == []
    assert [text.rpartition(": ")[2] for text in caplog.messages] == ["none"]
    caplog.clear()
    invalid = edge("base_link", "rear")
    invalid.transforms[0].transform.rotation.w = 0.0
    frames = frames_with(LASER, invalid)
    for now in (math.nan, 1000.0, 1000.0 + 0.9 * WAIT_FOR_TRANSFORM, 10.0, 10.0 + 0.9 * WAIT_FOR_TRANSFORM):
        frames.receive(scan_of("rear"))
        assert frames.placed(now) == []
    assert not caplog.records
    for _ in range(3):
        assert frames.placed(10.0 + 1.1 * WAIT_FOR_TRANSFORM) == []
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    assert record.message == (
        "scans wait: no transform from 'base_link' (--base-frame) to 'rear'; "
        "--lidar-from-robot uses that of the robot YAML; frames with transforms: 'base_link', 'laser', 'rear' (invalid)"
    )


OWN_MAP = edge("map", "odom", 1.0)


@pytest.mark.parametrize(("edges", "counts"), [([], False), ([OWN_MAP], False), ([edge("odom", "base_link")], True)])
def test_the_robot_yaml_places_the_lidar_only_if_there_are_no_transforms(edges, counts, caplog):
    frames = frames_with(*edges, static=False)
    frames.receive(scan_of())
    assert frames.placed(0.0) == frames.placed(0.9 * WAIT_FOR_TREE) == []
    found = mounts_of(frames.placed(WAIT_FOR_TREE))
    assert found == ([] if counts else [pytest.approx(YAML_MOUNT)])
    said = ["there are no transforms on /tf_static: the mount of the robot YAML is used"]
    assert [record.message for record in caplog.records] == ([] if counts else said)


@pytest.mark.parametrize("is_same", [False, True])
def test_transforms_that_come_after_the_mount_of_the_robot_yaml_must_not_move_the_lidar(is_same, caplog):
    frames = frames_with()
    for now in (0.0, WAIT_FOR_TREE):
        frames.receive(scan_of())
        scans = frames.placed(now)
    assert len(scans) == 2
    x, y, yaw = YAML_MOUNT
    frames.add(edge("base_link", "laser", x, y, yaw if is_same else yaw + 1.0), static=True)
    frames.receive(scan_of())
    assert len(frames.placed(WAIT_FOR_TREE + 1.0)) == is_same
    assert ("late" in caplog.text) != is_same
    assert ("restart" in frames.explain("no scan for 1.0 s")) != is_same


@pytest.mark.parametrize("wrong", [{"child_frame_id": 5}, {"transform": None}, {"header": None}, "rotation", "stamp"])
def test_a_damaged_transform_leaves_the_others_of_its_message(wrong, caplog):
    message = edge("base_link", "camera")
    one = message.transforms[0]
    if wrong == "rotation":
        one.transform.rotation.w = None  # not a number, in rosbridge
    elif wrong == "stamp":
        one.header.stamp.sec = 10**12
    else:
        vars(one).update(wrong)
    message.transforms += LASER.transforms
    frames = frames_with(*[message] * 3)
    frames.receive(scan_of())
    assert mounts_of(frames.placed(0.0)) == [pytest.approx((0.2, 0.0, 1.5))]
    assert len(caplog.messages) == 1
    assert "the transform of frame" in caplog.text


def test_a_lidar_on_a_joint_that_moves_is_placed_at_the_time_of_each_scan():
    frames = frames_with(edge("turret", "laser", 0.1))
    found = []
    for k in range(9, 13):
        frames.add(edge("base_link", "turret", yaw=0.5 * k - 5.0, time=0.1 * k), static=False)
        if k == 10:
            for time in (1.0, 1.15, 1.3):
                frames.receive(scan_of(time=time))
        found.append(mounts_of(frames.placed(0.1 * k)))
    assert [len(each) for each in found] == [0, 1, 0, 1]
    turned = 0.1 * math.cos(0.75), 0.1 * math.sin(0.75), 0.75
    np.testing.assert_allclose(found[1] + found[3], [(0.1, 0.0, 0.0), turned], atol=1e-6)


def test_transforms_begin_anew_if_the_clock_steps_back():
    frames = frames_with()
    for time, yaw in ((100.0, 1.0), (101.0, 2.0), (10.0, 0.2), (11.0, 0.4)):
        frames.add(edge("base_link", "laser", yaw=yaw, time=time), static=False)
    frames.receive(scan_of(time=10.5))
    assert mounts_of(frames.placed(10.5)) == [pytest.approx((0.0, 0.0, 0.3))]
    frames.receive(scan_of(time=100.5))
    assert frames.placed(11.0) == []


def test_a_static_transform_that_is_sent_again_moves_the_lidar():
    frames = frames_with()
    found = []
    for yaw in (0.5, 1.5):
        frames.add(edge("base_link", "laser", yaw=yaw), static=True)
        frames.receive(scan_of())
        found += mounts_of(frames.placed(0.0))
    np.testing.assert_allclose(found, [(0.0, 0.0, 0.5), (0.0, 0.0, 1.5)])


def test_the_wait_for_a_transform_begins_anew_after_each_scan_that_was_placed(caplog):
    frames = frames_with()
    for time in (0.0, 1.0):
        frames.add(edge("base_link", "laser", yaw=0.1 * time, time=time), static=False)
    for now in (4.0, 8.0, 12.0):
        frames.receive(scan_of(time=now))
        assert frames.placed(now) == []
        frames.add(edge("base_link", "laser", yaw=0.1 * now, time=now), static=False)
        assert len(frames.placed(now)) == 1
    assert not caplog.records


def test_memory_of_transforms_is_limited():
    frames = frames_of()
    for k in range(MAX_TRANSFORMS + 100):
        frames.add(edge("base_link", "turret", yaw=0.01 * k, time=0.1 * k), static=False)
        frames.add(LASER, static=True)
    assert len(frames._tree.stamps("turret", "base_link")) == MAX_TRANSFORMS
    assert len(frames._tree.stamps("laser", "base_link")) == MAX_TRANSFORMS


@pytest.mark.parametrize(("tilt", "count", "text"), [(0.3, 1, ""), (0.6, 0, "34 degrees"), (1.5, 0, "86 degrees")])
@pytest.mark.parametrize("roll", [0.0, math.pi])
def test_scans_of_a_tilted_lidar_are_refused_with_the_reason(tilt, count, text, roll, caplog):
    frames = frames_with(edge("base_link", "laser", euler=(roll, tilt, 0.0)))
    for time in (1.0, 1.1):
        frames.receive(scan_of(time=time))
        assert len(frames.placed(time)) == count
    said = [record.message for record in caplog.records]
    assert len(said) == bool(text)
    assert text in "".join(said)


def test_two_lidars_on_one_topic(caplog):
    frames = frames_with(LASER, edge("base_link", "rear", -0.2, yaw=3.0))
    for k in range(6):
        frames.receive(scan_of(("laser", "rear")[k % 2], time=k))
    assert mounts_of(frames.placed(6.0)) == [pytest.approx((0.2, 0.0, 1.5))] * 3
    (record,) = caplog.records
    assert "messages of frame 'rear' are ignored, expected 'laser'; see the options of frames" in record.message
    assert mount_by(LASER, edge("base_link", "rear", -0.2), frame="rear", laser_frame="/rear") == (-0.2, 0.0, 0.0)


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.2, 12.0, (0.2, 12.0)),
        *[(0.2, bad, (0.2, 3.5)) for bad in (None, math.nan, math.inf, 0.0, -1.0, 1e9)],
        *[(bad, 12.0, (0.1, 12.0)) for bad in (None, math.nan, math.inf, 0.0, -1.0)],
        (12.0, 0.2, (0.1, 0.2)),
        (12.0, 0.05, (0.1, 3.5)),
        (None, None, (0.1, 3.5)),
    ],
)
def test_invalid_range_limits_are_those_of_the_robot(low, high, expected, caplog):
    frames = frames_of(lidar_from_robot=True)
    for _ in range(2):
        frames.receive(scan_of(range_min=low, range_max=high))
        (scan,) = frames.placed(0.0)
        assert (scan.range_min, scan.range_max) == expected
    assert len(caplog.records) == ((low, high) != expected)


@pytest.mark.parametrize(("no_return", "expected"), [("inf", math.inf), ("nan", math.nan)])
def test_scans_may_lack_ranges_limits_and_times(no_return, expected):
    frames, scan = frames_of(lidar_from_robot=True, no_return=no_return), scan_of(ranges=[1.0, None, 2.0, None])
    for name in ("range_min", "range_max", "time_increment", "intensities", "angle_max"):
        delattr(scan, name)
    frames.receive(scan)
    (scan,) = frames.placed(0.0)
    assert (scan.range_min, scan.range_max, scan.time_increment) == (0.1, 3.5, 0.0)
    np.testing.assert_array_equal(scan.ranges, [1.0, expected, 2.0, expected])


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"angle_increment": 0.0}, "in steps of 0 rad"),
        ({"angle_increment": None}, "in steps of nan rad"),
        ({"angle_min": None}, "beams from nan rad"),
        ({"angle_increment": 3.0}, "cover more than a turn"),
        ({"ranges": np.zeros(0, np.float32)}, "0 beams"),
        ({"ranges": None}, "0 beams"),
    ],
)
def test_scans_that_cannot_be_used_are_dropped_with_one_warning(fields, reason, caplog):
    frames = frames_of(lidar_from_robot=True)
    for time in (1.0, 1.1, 1.2):
        frames.receive(scan_of(time=time, **fields))
        assert frames.placed(time) == []
    (record,) = caplog.records
    assert reason in record.message
    frames.receive(scan_of(time=1.3, angle_increment=-0.5, angle_min=0.75, time_increment=-0.01))
    (scan,) = frames.placed(1.3)
    assert (scan.step, scan.ranges.tolist()) == (0.5, [3.0, 3.0, 2.0, 1.0])
    np.testing.assert_allclose(scan.delays, [-0.03, -0.02, -0.01, 0.0])


@pytest.mark.parametrize(
    ("euler", "rates", "expected"),
    [
        ((0.0, 0.0, 1.0), (0.1, 0.2, 0.5), 0.5),
        ((math.pi, 0.0, 2.0), (0.1, 0.2, 0.5), -0.5),
        ((math.pi / 2, 0.0, 0.0), (0.1, 0.2, 0.5), 0.2),  # stands on its side
        ((0.0, math.pi / 2, 0.0), (0.1, 0.2, 0.5), -0.1),
        ((0.0, 0.3, 0.0), (-0.5 * math.sin(0.3), 0.0, 0.5 * math.cos(0.3)), 0.5),
        ((math.pi, 0.0, 0.0), (None, math.nan, 0.5), -0.5),  # an IMU that measures one axis
        ((math.pi / 2, 0.0, 0.0), (0.0, None, 0.5), math.nan),
    ],
)
def test_the_yaw_rate_of_an_imu_is_turned_into_the_base_frame(euler, rates, expected):
    edges = edge("base_footprint", "base_link", 0.1), edge("base_link", "imu", 0.2, euler=euler)
    frames = frames_with(*edges, child="base_footprint")
    assert frames.yaw_rate(imu_of(*rates), 0.0) == pytest.approx(expected, nan_ok=True)


def test_an_imu_without_a_fixed_transform_is_not_used_unless_there_are_none_at_all(caplog):
    frames = frames_with()
    assert frames.yaw_rate(imu_of(0.0, 0.0, 0.5), 0.0) is None
    assert frames.yaw_rate(imu_of(0.0, 0.0, 0.5), WAIT_FOR_TREE) == 0.5
    assert caplog.messages == ["there are no transforms on /tf_static: the IMU counts as upright"]
    for k in range(3):
        frames.add(edge("base_link", "turret", yaw=0.1 * k, time=k), static=False)
    frames.add(edge("turret", "imu"), static=True)
    for now in (4.0, 2.0 * WAIT_FOR_TRANSFORM, NEVER):
        assert frames.yaw_rate(imu_of(0.0, 0.0, 0.5), now) is None
    text = "the IMU is not used: no fixed transform from 'base_link' to 'imu'; frames with transforms: 'base_link', "
    assert caplog.messages[1:] == [text + "'imu', 'turret'"]


def test_the_pose_of_another_frame_of_odometry_is_moved_to_the_base(caplog):
    frames = frames_of(base_frame="base_link")
    assert odometry(frames, "base_link") == odometry(frames, "") == (1.0, 2.0, math.pi / 2)
    assert odometry(frames, "base_footprint") is None
    frames.add(edge("base_link", "base_footprint", -0.3, yaw=math.pi / 2), static=True)
    assert odometry(frames, "base_footprint", NEVER) == pytest.approx((1.3, 2.0, 0.0))
    assert odometry(frames, "gps", 0.0) is odometry(frames, "gps", WAIT_FOR_TRANSFORM) is None
    text = "odometry is not used: no fixed transform from 'gps' to --base-frame 'base_link'; "
    assert caplog.messages == [text + "frames with transforms: 'base_footprint', 'base_link'"]


def test_odometry_without_child_frame_needs_an_option_if_no_transform_has_a_usual_name(caplog):
    frames = frames_of()
    frames.add(edge("base", "laser"), static=True)
    assert odometry(frames, "") == (1.0, 2.0, math.pi / 2)
    frames.receive(scan_of())
    assert frames.placed(0.0) == frames.placed(WAIT_FOR_TRANSFORM) == []
    assert "no transform from '' (--base-frame) to 'laser'" in caplog.text
    assert "--base-frame" in frames.explain("no scan yet")
    assert mount_by(edge("base", "laser", 0.2), child="", base_frame="base") == (0.2, 0.0, 0.0)


def test_odometry_of_a_second_frame_is_ignored(caplog):
    frames = frames_of()
    assert odometry(frames, "base_link") == (1.0, 2.0, math.pi / 2)
    assert odometry(frames, "camera") is odometry(frames, "camera") is None
    assert frames.base == "base_link"
    (text,) = caplog.messages
    assert "odometry: messages of frame 'camera' are ignored, expected 'base_link'" in text


def driven(steps, *edges, turned=0.0, tf_odometry=False, publish=lambda k, time, topics: None, **options):
    """Drive a simulated robot whose lidar is turned; return session, robot and topics."""
    run = Drive(*edges, **options)
    robot = run.robot
    for k in range(steps):
        sensed = run.sensed()
        sensed["/odom"].child_frame_id = "base_link"
        sensed["/scan"].angle_min -= turned
        if tf_odometry:
            del sensed["/odom"]
            run.topics.publish("/tf", messages.transforms(robot.time, ("odom", "base_link", robot.odometry)))
        publish(k, robot.time, run.topics)
        run.step(sensed=sensed)
    return run.session, robot, run.topics


def error_of(session, robot):
    return math.dist(session.driver.belief.pose[:2], robot.start.between(robot.pose)[:2])


@pytest.mark.parametrize("how", [{}, {"tf_odometry": True, "odom_topic": "/tf"}, {"lidar_from_messages": True}])
def test_a_robot_with_a_lidar_that_is_turned_drives_by_its_transforms(how, caplog):
    laser = edge("base_link", "laser", -0.032, yaw=math.pi / 2)

    def late(k, time, topics):
        if k == 15:
            topics.publish("/tf_static", laser)

    session, robot, topics = driven(60, edge("base_link", "imu"), turned=math.pi / 2, publish=late, **how)
    assert error_of(session, robot) < 0.05
    assert math.dist(robot.start[:2], robot.pose[:2]) > 0.3
    sent = topics.last["/tf"].transforms[0]
    assert (sent.header.frame_id, sent.child_frame_id) == ("map", "odom")
    assert seconds(sent.header.stamp) == pytest.approx(session.time + session.driver.env.control_period)
    assert not [text for text in caplog.messages if "compiling kernels" not in text]


def test_a_robot_without_the_transform_of_its_lidar_stands(caplog):
    session, robot, _ = driven(60, edge("base_footprint", "laser", -0.032))
    assert robot.pose == robot.start
    assert session.reason == "no scan yet (scans wait for a transform from 'base_link' to 'laser')"
    assert "no transform from 'base_link' (--base-frame) to 'laser'" in caplog.text


def pose_message(frame, pose):
    made = messages.path(1.0, np.array([pose[:2]])).poses[0]
    made.header.frame_id = frame
    made.pose.orientation = SimpleNamespace(x=0.0, y=0.0, z=math.sin(pose[2] / 2), w=math.cos(pose[2] / 2))
    return made


def test_goals_of_the_odometry_and_the_base_frame_are_moved_to_the_map_and_others_are_refused(caplog):
    session, _, topics = driven(12, edge("base_link", "laser", -0.032), goal=(1.5, 0.0))
    given, driver = Pose2D(0.5, -0.2, 0.3), session.driver
    expected = {
        "": given,
        "map": given,
        "/odom": driver.map_to_odometry.compose(given),
        "base_link": driver.belief.pose.compose(given),
    }
    assert math.hypot(*expected["base_link"][:2]) > math.hypot(*given[:2]) + 0.01
    for frame, goal in expected.items():
        for topic in ("/goal_pose", "/move_base_simple/goal"):
            driver.goal(0.0, 0.0)
            topics.publish(topic, pose_message(frame, given))
            assert tuple(driver.env.task.goal) == pytest.approx(tuple(goal))
    assert not caplog.records
    before = driver.env.task.goal
    for _ in range(2):  # said once
        topics.publish("/goal_pose", pose_message("earth", Pose2D(9.0, 9.0, 0.0)))
    assert driver.env.task.goal == before
    assert [text.partition(";")[0] for text in caplog.messages] == [
        "goal: messages of frame 'earth' are ignored, expected 'map'"
    ]


def test_odometry_and_an_initial_pose_of_other_frames_are_ignored(caplog):
    session, robot, topics = driven(3, edge("base_link", "laser", -0.032))
    wrong = messages.odometry(robot.time, Pose2D(9.0, 9.0, 1.0), robot.twist)
    wrong.header.frame_id = "odom_combined"
    topics.publish("/odom", wrong)
    assert "messages of frame 'odom_combined' are ignored, expected 'odom'" in caplog.text
    assert not session.driver.dropped
    given = pose_message("odom", Pose2D(0.0, 0.0, 0.0))
    topics.publish("/initialpose", SimpleNamespace(header=given.header, pose=SimpleNamespace(pose=given.pose)))
    assert "initial pose: messages of frame 'odom' are ignored, expected 'map'" in caplog.text


def test_a_goal_before_the_first_scan_is_refused_with_a_warning(caplog):
    topics = Topics()
    drive.Session(drive.Options(policy="pursuit", goal=(1.0, 0.0), lidar_from_messages=True), topics)
    topics.publish("/goal_pose", pose_message("map", Pose2D(1.0, 0.0, 0.0)))
    assert caplog.messages == ["goals before the first scan are ignored"]


def test_the_yaw_rate_of_the_driver_is_that_of_the_base():
    def upside_down(k, time, topics):
        imu = imu_of(0.0, 0.0, -1.0)
        imu.header.stamp = messages.clock(time).clock
        topics.publish("/imu", imu)

    edges = edge("base_link", "laser", -0.032), edge("base_link", "imu", euler=(math.pi, 0.0, 0.0))
    session, _, _ = driven(12, *edges, imu_topic="/imu", publish=upside_down, slam="odometry")
    assert session.driver.env.reading.yaw_rate == pytest.approx(1.0)
