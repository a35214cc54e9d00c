from pathlib import Path

import pytest
import yaml

import lidarnaut.envs.robots
from lidarnaut.envs.robots import ROBOT_NAMES, load_robot

BURGER = Path(lidarnaut.envs.robots.__file__).parent / "library" / "turtlebot3_burger.yaml"


def written(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    return path


def test_a_name_a_path_and_the_robot_itself_are_the_same_robot():
    robot = load_robot("turtlebot3_burger")
    assert load_robot(BURGER) == load_robot(str(BURGER)) == robot
    assert load_robot(robot) is robot


def test_a_robot_of_the_users_own_by_module_and_attribute(tmp_path, monkeypatch):
    (tmp_path / "robot_of_mine.py").write_text(
        "import dataclasses\nfrom lidarnaut.envs.robots import load_robot\n"
        "slow = dataclasses.replace(load_robot('turtlebot3_burger'), max_v=0.1)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert load_robot("robot_of_mine:slow").max_v == 0.1
    with pytest.raises(ValueError, match="no attribute 'fast'"):
        load_robot("robot_of_mine:fast")


@pytest.mark.parametrize(
    ("key", "value", "complaint"),
    [
        ("drive.trak", 0.2, r"unknown key 'drive\.trak' \(did you mean 'track'\?\); allowed are wheel_radius"),
        ("wheels", {}, "unknown key 'wheels'"),
        ("lidar.rate", 12, "lidar: there is no key 'rate': a lidar scans once per control period, see control_hz"),
        ("max_v", -0.2, "max_v: Input should be greater than 0, got -0.2"),
        ("max_v", 220, "max_v 220 m/s and max_acc_v 1 m/s2 give a stopping distance of 2.42e.04 m, allowed are 1000"),
        ("lidar.mount.yaw", -90, r"lidar\.mount\.yaw: .*greater than or equal to -6\.28"),
        ("imu", {"compass_offset": 90.0}, r"imu\.compass_offset: .*less than or equal to 6\.28"),
        ("odometry.wheel_radius", 3.3, "odometry.wheel_radius is 3.3 m and drive.wheel_radius 0.033 m: allowed is a "),
        ("odometry.track", 0.07, "odometry.track is 0.07 m and drive.track 0.16 m: allowed is a factor of 2"),
        ("drive.track", float("nan"), r"drive\.track: .*finite"),
        ("lidar.scan_time", 1.1, r"lidar\.scan_time: .*less than or equal to 1, got 1\.1"),
        ("lidar.range_min", 5.0, "lidar: range_min must be less than range_max, got 5.0 and 3.5"),
        ("lidar.num_beams", 10**12, r"lidar\.num_beams: .*less than or equal to 20000, got 1000000000000"),
        ("lidar.range_max", 1e300, r"lidar\.range_max: .*less than or equal to 1000000000, got 1e\+300"),
        ("lidar.mount.x", -6400.0, r"lidar\.mount\.x: .*greater than or equal to -100, got -6400"),
        ("body.radius", 0.1, "body: .*either size or radius"),
        ("body.center", [0.0, 1e200, 0.0], r"body\.center\.1: .*less than or equal to 100"),
        ("casters", [{"x": 0.1, "y": 0.0, "radius": -1}], r"casters\.0\.radius: .*greater than 0, got -1"),
    ],
)
def test_errors_name_the_file_and_the_key(tmp_path, key, value, complaint):
    *parents, last = key.split(".")
    content = part = yaml.safe_load(BURGER.read_text())
    for parent in parents:
        part = part[parent]
    part[last] = value
    with pytest.raises(ValueError, match=r"mine\.yaml: .*" + complaint):
        load_robot(written(tmp_path, yaml.safe_dump(content)))


def test_what_is_no_robot_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"mine\.yaml: .*key 'drive' is missing"):
        load_robot(written(tmp_path, "name: x\n"))
    with pytest.raises(FileNotFoundError, match=r"gone\.yaml"):
        load_robot(tmp_path / "gone.yaml")
    with pytest.raises(TypeError, match="int"):
        load_robot(3)
    with pytest.raises(ValueError, match=r"'turtlebot4'.*" + ".*".join(ROBOT_NAMES)):
        load_robot("turtlebot4")
