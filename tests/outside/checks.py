"""Checks of written files: each returns why a tool disagrees, or nothing."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from lidarnaut.envs.files import read_mapping
from lidarnaut.envs.geometry.pose import between_poses
from lidarnaut.envs.logs import load_log
from lidarnaut.envs.logs.relations import relation_error
from lidarnaut.envs.logs.trajectory import rms, trajectory_errors
from lidarnaut.envs.robots import load_robot

from .environments import run
from .files import ROBOT, Files


class Check(NamedTuple):
    """One cell of the matrix."""

    file: str
    environment: str
    package: str
    compare: Callable[[Files], str]
    """Function that returns why the tool disagrees; empty if it agrees. `RefusedError` if the tool refuses the file."""
    known: str = ""
    """Reason of a known disagreement that is no fault of the file; the check then expects it."""


def close(found: Any, wanted: Any, tolerance: float, what: str) -> str:
    """Return why two arrays differ by more than an absolute tolerance; empty if they do not."""
    found, wanted = (np.asarray(each, dtype=float) for each in (found, wanted))
    if found.shape != wanted.shape:
        return f"{what} of shape {found.shape}, not {wanted.shape}"
    gap = float(np.abs(found - wanted).max(initial=0.0))
    return "" if gap <= tolerance else f"{what} {gap:.3g} apart"


def _differ(found: Any, wanted: Any) -> bool:
    """Return whether plain data differ by more than the precision of float32, in which some fields are written."""
    if isinstance(wanted, dict):
        return found.keys() != wanted.keys() or any(_differ(found[key], value) for key, value in wanted.items())
    if isinstance(wanted, list):
        return len(found) != len(wanted) or any(map(_differ, found, wanted))
    is_number = isinstance(wanted, float) and isinstance(found, (int, float))
    return not math.isclose(found, wanted, rel_tol=1e-7) if is_number else found != wanted


def _same_messages(found: dict[str, Any], wanted: dict[str, Any]) -> str:
    if found.keys() != wanted.keys():
        return f"other topics: {sorted(found.keys() ^ wanted.keys())}"
    for topic, messages in wanted.items():
        for k, (one, other) in enumerate(zip(found[topic], messages)):
            if _differ(one, other):
                return f"message {k} of {topic}"
        if len(found[topic]) != len(messages):
            return f"{len(found[topic])} messages of {topic}, not {len(messages)}"
    return ""


def _bag(environment: str, *client: str) -> Callable[[Files], str]:
    def compare(files: Files) -> str:
        found = run(environment, *client, files.bag.path)
        if found["latched"] != ["/map", "/tf_static"]:
            return f"latched topics {found['latched']}"
        stamps = [time for messages in found["messages"].values() for time, _ in messages]
        return "a time of 0" if min(stamps) <= 0 else _same_messages(found["messages"], files.bag.messages)

    return compare


IMAGES, ROS1_KINDS = ("map.pgm", "map.png", "scale.png"), ("", " in BZ2", " in LZ4")


def _ros1_bag(kind: str, environment: str, client: str) -> Callable[[Files], str]:
    def compare(files: Files) -> str:
        found = run(environment, client, "read", files.bags_of_others[f"rosbags, ROS 1{kind}"])["messages"]
        people = "/ground_truth/people"  # markers have other fields in ROS 1
        kept = [{topic: one[topic] for topic in one if topic != people} for one in (found, files.bag.messages)]
        return _same_messages(*kept)

    return compare


def _placed_scans(files: Files) -> str:
    messages = {topic: files.bag.messages[topic] for topic in ("/scan", "/tf", "/tf_static")}
    lidar = load_robot(ROBOT).lidar
    mount, turn = lidar.mount, Rotation.from_euler("xyz", [lidar.mount.roll, lidar.mount.pitch, lidar.mount.yaw])
    placed = run("debian", "debian.py", "place", given=messages)
    for k, (points, log_pose) in enumerate(zip(placed, _odometry(files))):
        ranges = np.array([float(value) for value in messages["/scan"][k][1]["ranges"]])
        seen = np.isfinite(ranges) & (ranges < np.float32(lidar.range_max))
        directions = np.stack([np.cos(lidar.angles), np.sin(lidar.angles), 0 * lidar.angles], axis=1)
        rays = ranges[seen, None] * directions[seen]
        in_base = turn.apply(rays) + [mount.x, mount.y, mount.z]
        wanted = Rotation.from_euler("z", log_pose[2]).apply(in_base) + [*log_pose[:2], 0.0]
        if isinstance(points, str) or (gap := close(points, wanted, 1e-3, f"points of scan {k} [m]")):
            return points if isinstance(points, str) else gap
    return ""


def _odometry(files: Files) -> np.ndarray:
    log = files.bag.log
    return log.odometry[log.scan_rows]


def _drawn(files: Files) -> str:
    _, message = files.bag.messages["/map"][-1]
    moves = [one["transform"] for one in files.bag.messages["/tf"][-1][1]["transforms"]]
    start = {"position": {"x": 0.3, "y": -0.2, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    found = run("npm", "ros2d.mjs", given={"map": message, "transforms": moves[::-1], "pose": start})
    grid = np.reshape(message["data"], (message["info"]["height"], message["info"]["width"]))[::-1]
    wanted = np.where(grid == 100, 0, np.where(grid == 0, 255, 127))
    origin = message["info"]["origin"]["position"]
    top = -origin["y"] - len(grid) * message["info"]["resolution"]
    pose = np.array([0.3, -0.2])
    for move in reversed(moves):
        turn = Rotation.from_quat([move["rotation"][axis] for axis in "xyzw"])
        pose = turn.apply([*pose, 0.0])[:2] + [move["translation"]["x"], move["translation"]["y"]]
    return (
        close(found["grey"], wanted.ravel(), 0, "grey values")
        or close([found["x"], found["y"]], [origin["x"], top], 1e-9, "corner [m]")
        or close([found["pose"]["position"][axis] for axis in "xy"], pose, 1e-9, "composed pose [m]")
    )


def _trajectory(files: Files) -> str:
    one = files.trajectory
    found = run("graphs", "graphs.py", "errors", one.path, one.truth_path)
    if not found["valid"] or found["poses"] != len(one.times):
        return f"check: {found['details']}, {found['poses']} poses"
    k = np.arange(len(one.times) - 1)
    relations = np.column_stack([one.times[k], one.times[k + 1], between_poses(one.truth[k], one.truth[k + 1])])
    error = relation_error(one.times, one.poses, relations)
    ours = rms(trajectory_errors(one.poses, one.truth)[0]), error.translation, error.translation_std, error.rotation
    theirs = found["ape"]["rmse"], found["rpe"]["mean"], found["rpe"]["std"], found["rpe_angle"]["mean"]
    return close(theirs, ours, 2e-4, "errors [m, m, m, deg]")


def _graph(library: str) -> Callable[[Files], str]:
    def compare(files: Files) -> str:
        graph, found = files.graph, run("graphs", "graphs.py", "optimise", library, files.graph.path)
        if found["sizes"] != [len(graph.poses), graph.num_edges]:
            return f"{found['sizes'][0]} vertices and {found['sizes'][1]} edges"
        poses, wanted = np.array(found["poses"]), graph.poses
        ratios = [found["before"] / graph.before, found["after"] / graph.after]
        gap = close(ratios, [1.0, 1.0], 1e-3, f"chi2 {found['before']:.6g}, {found['after']:.6g}: ratios")
        return gap or close(poses, wanted[:, :2], 1e-3, "optimum [m]")

    return compare


def _map(library: str, image: str) -> Callable[[Files], str]:
    def compare(files: Files) -> str:
        file = files.saved_map(image)
        found = run("maps", "maps.py", "read", library, file.parent / image, file)
        pixels = np.asarray(Image.open(file.parent / image))
        wrong = [key for key, value in read_mapping(file).items() if found["yaml"].get(key) != value]
        return f"YAML: {wrong}" if wrong else close(found["pixels"], pixels, 0, "pixels")

    return compare


def _policy(library: str) -> Callable[[Files], str]:
    def compare(files: Files) -> str:
        import onnxruntime

        session, rng = onnxruntime.InferenceSession(files.policy), np.random.default_rng(5)
        given, wanted = [], []
        for size in (1, 64):
            arrays = {one.name: rng.random((size, *one.shape[1:]), dtype=np.float32) for one in session.get_inputs()}
            given.append({name: array.tolist() for name, array in arrays.items()})
            wanted.append(session.run(None, arrays))
        found = run("onnx", "policies.py", library, files.policy, given=given)
        gaps = [close(a, b, 1e-5, f"batch {len(b)}") for one, two in zip(found, wanted) for a, b in zip(one, two)]
        return next(filter(None, gaps), "")

    return compare


def _robot(library: str) -> Callable[[Files], str]:
    def compare(files: Files) -> str:
        robot, found = load_robot(ROBOT), run("robots", "robots.py", "load", library, files.urdf)
        drive, mount = robot.drive, robot.lidar.mount
        rate = (robot.max_v + 0.5 * robot.odometry.track * robot.max_w) / robot.odometry.wheel_radius
        limits = [drive.max_torque, rate]
        turn = Rotation.from_euler("xyz", [mount.roll, mount.pitch, mount.yaw]).as_matrix()
        mass = robot.body.mass * (1.002 + 1e-3 * len(robot.casters)) + 2 * drive.wheel_mass
        if gap := close(found["mass"], mass, 1e-6, "mass [kg]"):
            return gap
        wheels = [[0.0, y, drive.wheel_radius, *limits] for y in (0.5 * drive.track, -0.5 * drive.track)]
        return (
            close(list(found["wheels"].values()), wheels, 1e-6, "wheels [m, N m, rad/s]")
            or close(found["axes"], [[0, 1, 0]] * 2, 1e-9, "axes")
            or close(found["laser"][0], [mount.x, mount.y, mount.z], 1e-6, "mount [m]")
            or close(found["laser"][1], turn, 1e-6, "mount (rotation)")
        )

    return compare


def same_log(path: Any, files: Files) -> str:
    """Return why a bag is read as another log than that of the package's own bag."""
    found, wanted = load_log(path), files.bag.log
    if found.notes:
        return f"notes: {found.notes}"
    ranges = [np.nan_to_num(log.ranges, nan=-1.0, posinf=-2.0) for log in (found, wanted)]
    angles = [log.lidar.angles + log.lidar.mount.yaw for log in (found, wanted)]
    return (
        close(found.times, wanted.times, 1e-6, "times [s]")
        or close(found.odometry, wanted.odometry, 1e-9, "odometry [m]")
        or close(*ranges, 0, "ranges [m]")
        or close(*angles, 1e-6, "angles [rad]")
        or ("" if math.isclose(found.lidar.range_max, wanted.lidar.range_max) else "range_max")
    )


BAG, ROS1, MAP, GRAPH = "bag (MCAP)", "bag (ROS 1{}, converted by rosbags)", "map ({})", "pose graph (g2o)"
POLICY, URDF = "policy (ONNX)", "robot (URDF)"
OTHER_ERROR = "its error is that of the inverse motion"
OTHER_FRAMES = "it reads only LZ4 frames with a checksum, without a size, and of independent blocks"
NO_ROOT = "the root link becomes a part of the world"
CHECKS = [
    Check(BAG, "bags", "rosbags", _bag("bags", "bags.py", "read", "rosbags")),
    Check(BAG, "bags", "mcap-ros2-support", _bag("bags", "bags.py", "read", "mcap")),
    Check(BAG, "npm", "@mcap/core", _bag("npm", "bags.mjs", "read")),
    Check(f"{BAG}: scans placed by `/tf`", "debian", "python3-tf2", _placed_scans),
    Check(f"{BAG}: map and poses", "npm", "ros2d", _drawn),
    *(Check(ROS1.format(kind), "npm", "@foxglove/rosbag", _ros1_bag(kind, "npm", "bags.mjs")) for kind in ROS1_KINDS),
    *(
        Check(ROS1.format(kind), "debian", "python3-rosbag", _ros1_bag(kind, "debian", "debian.py"), known)
        for kind, known in zip(ROS1_KINDS, ("", "", OTHER_FRAMES))
    ),
    Check("trajectory (TUM)", "graphs", "evo", _trajectory),
    Check(GRAPH, "graphs", "gtsam", _graph("gtsam")),
    Check(GRAPH, "graphs", "g2opy", _graph("g2opy")),
    Check(GRAPH, "graphs", "graphslam", _graph("graphslam"), OTHER_ERROR),
    *(Check(MAP.format(image), "maps", "pillow", _map("pillow", image)) for image in IMAGES),
    *(Check(MAP.format(image), "maps", "opencv-python-headless", _map("opencv", image)) for image in IMAGES),
    Check(POLICY, "onnx", "onnxruntime", _policy("onnxruntime")),
    Check(POLICY, "onnx", "onnx", _policy("reference")),
    Check(POLICY, "onnx", "openvino", _policy("openvino")),
    Check(URDF, "robots", "pybullet", _robot("pybullet")),
    Check(URDF, "robots", "yourdfpy", _robot("yourdfpy")),
    Check(URDF, "robots", "pin", _robot("pinocchio")),
    Check(URDF, "robots", "mujoco", _robot("mujoco"), NO_ROOT),
]
