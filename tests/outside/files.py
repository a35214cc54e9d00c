"""Files of the package, for the checks: written once, in a temporary folder."""

import functools
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import gymnasium
import numpy as np

import lidarnaut
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.logs import load_log
from lidarnaut.envs.logs.bag_writer import BagWriter
from lidarnaut.envs.logs.runs import save_g2o
from lidarnaut.envs.logs.trajectory import save_trajectory
from lidarnaut.envs.robots import LidarParams, Mount, load_robot
from lidarnaut.envs.slam.posegraph import PoseGraph, PoseGraphView, chi_squares
from lidarnaut.envs.worlds import save_map
from lidarnaut.envs.wrappers.record_bag import BagRecorder
from tests.slam.graph.test_optimise import optimise

from .clients.client import plain
from .environments import run

_CREATE = load_robot("create3")
_MOUNT = Mount(x=0.1, y=0.04, z=0.25, yaw=0.6, pitch=0.05, roll=-0.04)
ROBOT = replace(
    _CREATE,
    lidar=LidarParams(num_beams=90, range_min=0.1, range_max=3.0, mount=_MOUNT),
    odometry=replace(_CREATE.odometry, wheel_radius=0.035),
)
"""A robot whose lidar is mounted off the axes: forward, to the left, turned and tilted; its odometry is wrong."""


class Files:
    """Files that this package writes, and their content in memory."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def folder_of(self, name: str) -> Path:
        path = self.folder / name
        path.mkdir(exist_ok=True)
        return path

    @functools.cached_property
    def bag(self) -> SimpleNamespace:
        """An episode: `path`, and `messages` as plain data by topic, with the time of recording [ns]."""
        path, messages, write = self.folder / "drive.mcap", dict[str, list[Any]](), BagWriter.write

        def listen(writer: BagWriter, topic: str, time: float, message: Any) -> None:
            messages.setdefault(topic, []).append([round(time * 1e9), plain(message)])
            write(writer, topic, time, message)

        arguments = {"world": "rooms", "world_size": (8.0, 8.0), "physics": "kinematic", "people": 2}
        with (
            gymnasium.make("lidarnaut/Explore-v0", robot=ROBOT, **arguments) as env,
            patch.object(BagWriter, "write", listen),
            BagRecorder(env, path),
        ):
            env.reset(seed=3)
            for k in range(60):
                env.step(np.array([0.8, np.sin(0.3 * k)], dtype=np.float32))
        return SimpleNamespace(path=path, messages=messages, log=load_log(path))

    @functools.cached_property
    def bags_of_others(self) -> dict[str, str]:
        """Paths of the messages of the bag as others write them, by tool and form."""
        folder = self.folder_of("bags")
        found = run("bags", "bags", "write", self.bag.path, folder)
        found |= run("npm", "bags", "write", self.bag.path, folder / "js.mcap")
        return found | run("debian", "debian", "write", found["rosbags, ROS 1"], folder)

    @functools.cached_property
    def trajectory(self) -> SimpleNamespace:
        """A true path and an estimate of it: `times` [s], `poses`, `truth`, and both files in TUM format."""
        rng, times = np.random.default_rng(0), 1e9 + 0.1 * np.arange(200)
        truth = np.stack([np.cos(0.03 * np.arange(200)), np.sin(0.03 * np.arange(200)), 0.03 * np.arange(200) - 3.0]).T
        poses = truth + rng.normal(0.0, 0.02, truth.shape)
        paths = self.folder / "estimate.txt", self.folder / "truth.txt"
        for path, rows in zip(paths, (poses, truth)):
            save_trajectory(path, times, rows)
        return SimpleNamespace(times=times, poses=poses, truth=truth, path=paths[0], truth_path=paths[1])

    @functools.cached_property
    def graph(self) -> SimpleNamespace:
        """A pose graph of 4 submaps and 40 nodes on a circle: `path`, chi2 `before` and `after`, and `poses` after."""
        rng, graph, angles = np.random.default_rng(1), PoseGraph(), 2.0 * np.pi * np.arange(40) / 40
        truth = [Pose2D(5.0 * np.cos(angle), 5.0 * np.sin(angle), angle + np.pi / 2) for angle in angles]
        for k, pose in enumerate(truth[::10]):
            graph.add_submap(pose + (rng.normal(0.0, [0.1, 0.1, 0.03]) if k else np.zeros(3)))
        for k, pose in enumerate(truth):
            graph.add_node(pose + rng.normal(0.0, [0.1, 0.1, 0.03]))
            for submap in {k // 10, (k // 10 + 1) % 4, (k // 10 - 1) % 4}:
                relative = truth[10 * submap].between(pose) + rng.normal(0.0, 0.02, 3)
                graph.add_constraint(k, submap, relative, np.diag([0.02, 0.05, 0.01]) ** 2)
        view = PoseGraphView(graph.arrays)
        save_g2o(path := self.folder / "graph.g2o", view.nodes, view.edges)
        before = chi_squares(graph.arrays).sum()
        optimise(graph.arrays, phi=np.inf, max_iterations=60, tolerance=1e-11)
        after = chi_squares(graph.arrays).sum()
        return SimpleNamespace(path=path, before=before, after=after, poses=view.nodes, num_edges=len(view.edges))

    @functools.cached_property
    def grid(self) -> OccupancyGrid:
        """A map of 40 x 30 cells with percentages and unknown cells."""
        data = np.random.default_rng(2).choice(np.array([-1, 0, 3, 40, 77, 100], dtype=np.int8), (30, 40))
        return OccupancyGrid(data, 0.05, (-1.25, 2.5))

    @functools.cache  # noqa: B019
    def saved_map(self, name: str) -> Path:
        """Return the YAML file of the map; `name`: that of the image."""
        return save_map(self.grid, self.folder / name, "scale" if "scale" in name else "trinary")

    @functools.cached_property
    def policy(self) -> Path:
        """A pretrained policy as an ONNX file."""
        lidarnaut.export_policy("ppo:pretrained/twist", path := self.folder / "twist.onnx")
        return path

    @functools.cached_property
    def urdf(self) -> Path:
        return lidarnaut.export_urdf(ROBOT, self.folder / "robot.urdf")
