import math

import numpy as np
import pytest

from lidarnaut.envs.geometry.raycast import Beams, cast_rays
from lidarnaut.envs.logs import load_log
from lidarnaut.envs.logs.replay import Options, main
from lidarnaut.envs.robots import load_robot
from tests.logs.bags import write_bag
from tests.rooms import make_room

ROOM = make_room(-3.0, -2.0, 4.0, 3.0, circles=[(1.5, 1.5, 0.3), (-1.5, -0.5, 0.4)])
BEAMS, PERIOD, SPEED, YAW_RATE = 180, 0.18, 0.3, 0.9


def pose_at(time):
    """Return the base pose on a circle, the motion of exact odometry."""
    theta = YAW_RATE * time
    return SPEED / YAW_RATE * math.sin(theta), SPEED / YAW_RATE * (1.0 - math.cos(theta)), theta


def measured(time, first, step, sweep, turn, roll):
    """Return a scan whose beam k is measured at `time` + k `sweep` / `BEAMS`, from a lidar 0.1 m ahead of the base."""
    ranges, sign = np.empty(BEAMS, dtype=np.float32), -1.0 if roll else 1.0
    for k in range(BEAMS):
        x, y, theta = pose_at(time + k * sweep / BEAMS)
        sensor = x + 0.1 * math.cos(theta), y + 0.1 * math.sin(theta), theta + turn + sign * (first + k * step)
        cast_rays(*sensor, Beams(0.0, 0.1, 8.0), ROOM.segments, ROOM.circles, ranges[k : k + 1])
    return ranges


def record(path, sweep, *, first=-math.pi, step=2.0 * math.pi / BEAMS, turn=0.0, roll=0.0, given=None, rate=50.0,
           jump=math.inf, begin=0.25, num_scans=15):  # fmt: skip
    """Write a bag; `given`: `time_increment` of the messages, by default the true one.

    `jump`: time at which odometry jumps by 5 m [s]. `begin`: time of the first scan [s].
    """

    def messages(m):
        yield "/tf_static", m.transforms(0.0, ("base_link", "laser", 0.1, 0.0, turn, roll))
        for k in range(math.ceil((begin + num_scans * PERIOD + 1.05) * rate) + 1):
            x, y, theta = pose_at(k / rate)
            yield "/odom", m.odometry(100.0 + k / rate, x, y + 5.0 * (k / rate > jump), theta)
        for k in range(num_scans):
            time = begin + k * PERIOD
            scan = m.scan(100.0 + time, measured(time, first, step, sweep, turn, roll), angle_min=first, step=step)
            scan.time_increment = sweep / BEAMS if given is None else given
            yield "/scan", scan

    return write_bag(path, messages)


@pytest.mark.parametrize(
    "beams",
    [
        {},
        {"step": -2.0 * math.pi / BEAMS, "first": math.pi},
        {"roll": math.pi, "turn": 2.0},
        {"sweep": -PERIOD},
        {"sweep": -PERIOD, "step": -2.0 * math.pi / BEAMS, "first": 1.0},
        {"step": 4.0 / BEAMS, "first": -2.0},
        {"rate": 20.0},
    ],
)
def test_all_beams_are_referred_to_the_stamp(tmp_path, beams):
    logs = {}
    for name, sweep, given in (
        ("exact", 0.0, None),
        ("deskewed", beams.get("sweep", PERIOD), None),
        ("skewed", beams.get("sweep", PERIOD), 0.0),
    ):
        logs[name] = load_log(record(tmp_path / name, **{**beams, "sweep": sweep, "given": given}))
    assert logs["deskewed"].lidar == logs["exact"].lidar
    np.testing.assert_array_equal(logs["deskewed"].scan_rows, logs["exact"].scan_rows)
    errors = {name: np.abs(log.ranges - logs["exact"].ranges) for name, log in logs.items()}
    assert np.nanquantile(errors["deskewed"], 0.9) < 3e-3
    assert np.nanquantile(errors["skewed"], 0.6) > 0.05
    assert np.isnan(errors["deskewed"]).mean() < 0.05  # a gap where the robot turns against the lidar
    assert not logs["deskewed"].notes


@pytest.mark.parametrize("given", [math.nan, math.inf, PERIOD, -0.1, 3.0 * PERIOD / BEAMS])
def test_wrong_times_are_ignored_with_a_note(tmp_path, given):
    log = load_log(record(tmp_path / "log", 0.0, given=given))
    np.testing.assert_array_equal(log.ranges, load_log(record(tmp_path / "exact", 0.0)).ranges)
    assert len(log.notes) == 1
    assert f"time_increment of 15 of 15 scans is ignored: {given:g} s between beams, but 0.18 s" in log.notes[0]


def test_scans_during_a_jump_of_odometry_are_not_corrected(tmp_path):
    skewed = load_log(record(tmp_path / "skewed", PERIOD, given=0.0))
    log = load_log(record(tmp_path / "jump", PERIOD, jump=1.41))
    is_skewed = [np.array_equal(one, other, equal_nan=True) for one, other in zip(log.ranges, skewed.ranges)]
    assert np.flatnonzero(is_skewed).tolist() == [6]  # from 1.33 to 1.51 s


def test_odometry_that_is_exact_needs_no_scales(tmp_path):
    path = record(tmp_path / "log", PERIOD, first=0.0, begin=0.0, num_scans=65)
    (run,) = main(Options(path, slam="hector", preset="default"))
    assert run.odometry_scales == pytest.approx((1.0, 1.0), abs=0.01)


def hall(tmp_path, clear, num_scans=6):
    """Write a bag in a room; beams beyond 2.5 m are `clear`, and one beam is below `range_min`."""

    def messages(m):
        yield "/tf_static", m.transforms(0.0, ("base_link", "laser", 0.1, 0.0, 0.0, 0.0))
        for k in range(num_scans):
            ranges = measured(0.0, 0.0, 2.0 * math.pi / BEAMS, 0.0, 0.0, 0.0)
            ranges[ranges > 2.5], ranges[0] = clear, 0.05
            yield "/odom", m.odometry(10.0 + k, 0.0, 0.0, 0.0)
            yield "/scan", m.scan(10.0 + k, ranges, angle_min=0.0, step=2.0 * math.pi / BEAMS)

    return write_bag(tmp_path / f"hall_{clear}", messages)


def test_zero_may_mean_no_return(tmp_path):
    exact = load_log(hall(tmp_path, math.inf))
    assert not exact.notes
    assert 0.2 < np.isposinf(exact.ranges).mean() < 0.8
    path = hall(tmp_path, 0.0)
    np.testing.assert_array_equal(load_log(path, no_return="zero").ranges, exact.ranges)
    log = load_log(path)
    np.testing.assert_array_equal(log.ranges, np.where(np.isposinf(exact.ranges), np.nan, exact.ranges))
    share = f"{100.0 * np.isposinf(exact.ranges).mean():.0f} % of the beams are 0.0"
    assert share in log.notes[0]
    assert "--no-return zero" in log.notes[0]
    for options, has_advice in (
        ({"no_return": "zero"}, False),
        ({"robot": "turtlebot3_burger"}, False),
        ({"robot": "turtlebot3_burger", "no_return": "inf"}, True),
    ):
        main(Options(path, slam="odometry", preset="default", out=tmp_path / "out", **options))
        assert (share in (tmp_path / "out" / "summary.json").read_text()) == has_advice
    with pytest.raises(ValueError, match="no_return must be 'inf' or 'zero', got 'nan'"):
        load_log(path, no_return="nan")


def test_few_zeros_or_other_clear_beams_cause_no_advice(tmp_path):
    def messages(m):
        yield "/tf_static", m.transforms(0.0, ("base_link", "laser", 0.0, 0.0, 0.0, 0.0))
        for k in range(20):
            yield "/odom", m.odometry(10.0 + k, 0.0, 0.0, 0.0)
            yield "/scan", m.scan(10.0 + k, [0.0, 0.0, math.inf, math.inf, math.inf, 1.0, 9.0, 2.0])

    log = load_log(write_bag(tmp_path / "log", messages))
    assert np.isnan(log.ranges[:, :2]).all()
    assert not log.notes


def test_the_lidar_of_the_turtlebots_reports_no_return_as_zero():
    assert {load_robot(name).lidar.no_return for name in ("turtlebot3_burger", "turtlebot3_waffle_pi")} == {"zero"}
    assert load_robot("jackal").lidar.no_return == "inf"
