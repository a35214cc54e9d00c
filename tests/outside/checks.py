"""Checks of written files, of simulated scans, and of trainings: each raises an AssertionError if a tool disagrees."""

import math
import os
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from lidarnaut.envs.files import read_mapping
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.pose import between_poses
from lidarnaut.envs.logs.relations import relation_error
from lidarnaut.envs.logs.trajectory import rms, trajectory_errors
from lidarnaut.envs.robots import LidarParams
from tests.rooms import make_room, make_simulator

from .cells import Cell, close, same
from .environments import ROOT, call, make, run, versioned
from .files import ROBOT, Files

TRAININGS = {one: one for one in ("minari", "pettingzoo", "rl_zoo3", "skrl", "tianshou", "torchrl")}
TRAININGS |= {"optuna": "search", "ray[rllib]": "rllib", "sbx-rl": "sbx"}
"""Words of tests in `tests/examples` by library."""


def bag(environment: str, function: str, files: Files) -> None:
    found = run(environment, "bags", function, files.bag.path)
    same(found["latched"], ["/map", "/tf_static"], "latched")
    assert all(time > 0 for messages in found["messages"].values() for time, _ in messages), "a time of 0"
    same(found["messages"], files.bag.messages)


def ros1_bag(environment: str, client: str, form: str, files: Files) -> None:
    found = run(environment, client, "read", files.bags_of_others[f"rosbags, {form}"])["messages"]
    people = "/ground_truth/people"  # markers have other fields in ROS 1
    same(*({topic: one[topic] for topic in one if topic != people} for one in (found, files.bag.messages)))


def placed_scans(files: Files) -> None:
    log, lidar = files.bag.log, ROBOT.lidar
    mount, turn = lidar.mount, Rotation.from_euler("xyz", [lidar.mount.roll, lidar.mount.pitch, lidar.mount.yaw])
    directions = np.stack([np.cos(lidar.angles), np.sin(lidar.angles), 0 * lidar.angles], axis=1)
    placed = run("debian", "debian", "place", files.bags_of_others["rosbags, ROS 1"])
    for k, ((points, frame), pose) in enumerate(zip(placed, log.odometry[log.scan_rows], strict=True)):
        ranges = np.array(files.bag.messages["/scan"][k][1]["ranges"], dtype=float)
        seen = np.isfinite(ranges) & (ranges < np.float32(lidar.range_max))
        in_base = turn.apply(ranges[seen, None] * directions[seen]) + [mount.x, mount.y, mount.z]
        wanted = Rotation.from_euler("z", pose[2]).apply(in_base) + [*pose[:2], 0.0]
        close(moved(frame, points), wanted, 1e-3, f"points of scan {k} [m]")


def moved(transform: dict[str, dict[str, float]], points: np.ndarray) -> np.ndarray:
    """Apply a transform of `/tf` to points, shape (n, 3) [m]."""
    turn = Rotation.from_quat([transform["rotation"][axis] for axis in "xyzw"])
    return turn.apply(points) + [transform["translation"][axis] for axis in "xyz"]


def drawn(files: Files) -> None:
    _, message = files.bag.messages["/map"][-1]
    moves = [one["transform"] for one in reversed(files.bag.messages["/tf"][-1][1]["transforms"])]
    start = {"position": {"x": 0.3, "y": -0.2, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    found = run("npm", "ros2d", "draw", map=message, transforms=moves, pose=start)
    grid = np.reshape(message["data"], (message["info"]["height"], message["info"]["width"]))[::-1]
    wanted = np.where(grid == 100, 0, np.where(grid == 0, 255, 127))
    origin, point = message["info"]["origin"]["position"], np.array([[0.3, -0.2, 0.0]])
    top = -origin["y"] - len(grid) * message["info"]["resolution"]
    for move in moves:
        point = moved(move, point)
    close(found["grey"], wanted.ravel(), 0, "grey values")
    close([found["x"], found["y"]], [origin["x"], top], 1e-9, "corner [m]")
    close([found["pose"]["position"][axis] for axis in "xy"], point[0, :2], 1e-9, "composed pose [m]")


def trajectory(files: Files) -> None:
    one = files.trajectory
    found = run("graphs", "graphs", "errors", one.path, one.truth_path)
    assert found["valid"], found["details"]
    assert found["poses"] == len(one.times), f"{found['poses']} poses"
    relations = np.column_stack([one.times[:-1], one.times[1:], between_poses(one.truth[:-1], one.truth[1:])])
    error = relation_error(one.times, one.poses, relations)
    ours = rms(trajectory_errors(one.poses, one.truth)[0]), error.translation, error.translation_std, error.rotation
    theirs = found["ape"]["rmse"], found["rpe"]["mean"], found["rpe"]["std"], found["rpe_angle"]["mean"]
    close(theirs, ours, 2e-4, "errors [m, m, m, deg]")


def graph(library: str, files: Files) -> None:
    ours, found = files.graph, run("graphs", "graphs", "optimise", library, files.graph.path)
    ratios = [found["before"] / ours.before, found["after"] / ours.after]
    close(found["sizes"], [len(ours.poses), ours.num_edges], 0, "numbers of vertices and edges")
    close(ratios, [1.0, 1.0], 1e-3, f"chi2 {found['before']:.6g}, {found['after']:.6g}: ratios")
    close(found["poses"], ours.poses[:, :2], 1e-3, "optimum [m]")


def saved_map(library: str, image: str, files: Files) -> None:
    file = files.saved_map(image)
    found = run("maps", "maps", "read", library, file.parent / image, file)
    same(found["yaml"], read_mapping(file), "YAML")
    close(found["pixels"], np.asarray(Image.open(file.parent / image)), 0, "pixels")


def policy(runtime: str, files: Files) -> None:
    import onnxruntime

    session, rng, batches, wanted = onnxruntime.InferenceSession(files.policy), np.random.default_rng(5), [], []
    for size in (1, 64):
        arrays = {one.name: rng.random((size, *one.shape[1:]), dtype=np.float32) for one in session.get_inputs()}
        batches.append({name: array.tolist() for name, array in arrays.items()})
        wanted.append(session.run(None, arrays))
    found = run("onnx", "policies", "run", runtime, files.policy, batches=batches)
    for k, (outputs, ours) in enumerate(zip(found, wanted, strict=True)):
        for one, other in zip(outputs, ours, strict=True):
            close(one, other, 1e-5, f"output of batch {k}")


def robot(library: str, files: Files) -> None:
    drive, mount, found = ROBOT.drive, ROBOT.lidar.mount, run("robots", "robots", "load", library, files.urdf)
    rate = (ROBOT.max_v + 0.5 * ROBOT.odometry.track * ROBOT.max_w) / ROBOT.odometry.wheel_radius
    turn = Rotation.from_euler("xyz", [mount.roll, mount.pitch, mount.yaw]).as_matrix()
    mass = ROBOT.body.mass * (1.002 + 1e-3 * len(ROBOT.casters)) + 2 * drive.wheel_mass
    wheels = [[0.0, y, drive.wheel_radius, drive.max_torque, rate] for y in (0.5 * drive.track, -0.5 * drive.track)]
    close(found["mass"], mass, 1e-6, "mass [kg]")
    close(list(found["wheels"].values()), wheels, 1e-6, "wheels [m, N m, rad/s]")
    close(found["axes"], [[0, 1, 0]] * 2, 1e-9, "axes")
    close(found["laser"][0], [mount.x, mount.y, mount.z], 1e-6, "mount [m]")
    close(found["laser"][1], turn, 1e-6, "mount (rotation)")


def scan(environment: str, simulator: str, degrees: float, files: Files) -> None:
    """Compare directions, ranges and the value at no return of 36 beams of 4 m with those of another simulator."""
    lidar = LidarParams(num_beams=36, range_max=4.0, fov=math.radians(degrees))
    world = make_room(0.0, 0.0, 8.0, 6.0, circles=[(2.5, 2.5, 0.3)])
    start = Pose2D(1.5, 1.0, 0.5)
    ours = make_simulator("kinematic", replace(ROBOT, lidar=lidar), 0.1)
    (reading,) = ours.reset(world, [start], np.random.default_rng(0).spawn(1))
    given = {"walls": world.segments.tolist(), "pillar": world.circles[0].tolist(), "start": start}
    given |= {"fov": lidar.fov, "beams": lidar.num_beams, "range_max": lidar.range_max}
    found = run(environment, "peers", simulator.replace("-", ""), files.folder_of(simulator), **given)
    angles, ranges, is_hit = np.array(found["angles"]), np.array(found["ranges"]), np.isfinite(reading.ranges)
    is_same = np.abs(np.sin(0.5 * (angles - lidar.angles))).max() < 1e-5
    if is_same:
        close(ranges[is_hit], reading.ranges[is_hit], 1e-3, "ranges [m]")
    first, step, missed = np.degrees(angles[0]), np.degrees(angles[1] - angles[0]), ranges[~is_hit]
    told = [] if is_same else [f"first beam at {first:.4g} deg, steps of {step:.4g} deg"]
    told += [] if np.isinf(missed).all() else [f"no return is {missed[0]:.4g} m"]
    assert not told, "; ".join(told)


def training(library: str, files: Files) -> None:
    python, tests = make("learning") / "bin" / "python", ROOT / "tests" / "examples"
    command = [python, "-m", "pytest", "-q", "-k", TRAININGS[library], tests]
    assert "skipped" not in call(command, env=os.environ | {"OMP_NUM_THREADS": "1"}), "a test is skipped"


BAG, GRAPH, POLICY, URDF = "bag (MCAP)", "pose graph (g2o)", "policy (ONNX)", "robot (URDF)"
TWICE, MISS = "first beam at -180 deg, steps of 10.29 deg", "no return is 4 m"
LZ4_FRAMES = "it reads only LZ4 frames with a checksum, without a size, and of independent blocks"
FORMS = ("ROS 1", "ROS 1 in BZ2", "ROS 1 in LZ4")
CHECKS = [
    (BAG, "bags", "rosbags", partial(bag, "bags", "rosbags")),
    (BAG, "bags", "mcap-ros2-support", partial(bag, "bags", "mcap")),
    (BAG, "npm", "@mcap/core", partial(bag, "npm", "read")),
    (f"{BAG}: map and poses", "npm", "ros2d", drawn),
    ("bag (ROS 1): scans placed by `/tf`", "debian", "python3-tf2", placed_scans),
    *((f"bag ({form})", "npm", "@foxglove/rosbag", partial(ros1_bag, "npm", "bags", form)) for form in FORMS),
    *((f"bag ({form})", "debian", "python3-rosbag", partial(ros1_bag, "debian", "debian", form)) for form in FORMS),
    ("trajectory (TUM)", "graphs", "evo", trajectory),
    *((GRAPH, "graphs", library, partial(graph, library)) for library in ("gtsam", "g2opy", "graphslam")),
    *(
        (f"map ({image})", "maps", library, partial(saved_map, library, image))
        for library in ("pillow", "opencv-python-headless")
        for image in ("map.pgm", "map.png", "scale.png")
    ),
    *((POLICY, "onnx", library, partial(policy, library)) for library in ("onnxruntime", "onnx", "openvino")),
    *((URDF, "robots", library, partial(robot, library)) for library in ("pybullet", "yourdfpy", "pin", "mujoco")),
    *(
        (f"scan of {degrees} degrees", environment, simulator, partial(scan, environment, simulator, degrees))
        for environment, simulator in (("peers", "ir-sim"), ("peers", "navground"), ("learning", "vmas"))
        for degrees in (360, 270)
    ),
]
"""File, environment, package and comparison."""
DIFFERENT = {
    ("bag (ROS 1 in LZ4)", "python3-rosbag"): ("malformed", LZ4_FRAMES),
    (GRAPH, "graphslam"): ("chi2", "its error is that of the inverse motion"),
    (URDF, "mujoco"): ("mass", "the root link becomes a part of the world"),
    **{("scan of 270 degrees", simulator): (f"differs: {MISS}", "") for simulator in ("ir-sim", "navground", "vmas")},
    **{("scan of 360 degrees", simulator): (f"differs: {TWICE}; {MISS}", "") for simulator in ("ir-sim", "navground")},
    ("scan of 360 degrees", "vmas"): (f"differs: {MISS}", ""),
}
"""What differs by no fault of this package: symptom and reason."""


def read_by_others(files: Files, only: str) -> Iterator[Cell]:
    for file, environment, package, compare in CHECKS:
        if only in f"{file} {package}":
            different = DIFFERENT.get((file, package), ("", ""))
            yield Cell(file, versioned(environment, package), compare, "equal", *different)


def trained_by_others(files: Files, only: str) -> Iterator[Cell]:
    for library in sorted(TRAININGS):
        if only in f"learning {library}":
            yield Cell(library, versioned("learning", library).partition(" ")[2], partial(training, library), "runs")
