"""Files of the package, for the checks: written once, in a temporary folder."""

import functools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np

import lidarnaut
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.logs import load_log
from lidarnaut.envs.logs.bag_writer import BagWriter
from lidarnaut.envs.logs.runs import save_g2o
from lidarnaut.envs.logs.trajectory import save_trajectory
from lidarnaut.envs.slam.posegraph.graph import PoseGraph, PoseGraphView
from lidarnaut.envs.slam.posegraph.optimise import chi_squares, optimise_step
from lidarnaut.envs.worlds import save_map
from lidarnaut.envs.wrappers.record_bag import BagRecorder

from .clients.plain import plain
from .environments import run

ROBOT = Path(__file__).with_name("robot.yaml")
"""A robot whose lidar is mounted off the axes: forward, to the left, turned and tilted."""


class Files:
    """Files that this package writes, and their content in memory."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @functools.cached_property
    def bag(self) -> SimpleNamespace:
        """An episode: `path`, and `messages` as plain data by topic, with the time of recording [ns]."""
        path, messages, write = self.folder / "drive.mcap", dict[str, list[Any]](), BagWriter.write

        def listen(writer: BagWriter, topic: str, time: float, message: Any) -> None:
            messages.setdefault(topic, []).append([round(time * 1e9), plain(message)])
            write(writer, topic, time, message)

        arguments = {
            "world": "rooms",
            "world_size": (8.0, 8.0),
            "time_limit": 30.0,
            "physics": "kinematic",
            "people": 2,
        }
        with gymnasium.make("lidarnaut/Explore-v0", robot=str(ROBOT), **arguments) as env:
            BagWriter.write = listen  # type: ignore[method-assign]
            try:
                with BagRecorder(env, path):
                    env.reset(seed=3)
                    for k in range(60):
                        env.step(np.array([0.8, np.sin(0.3 * k)], dtype=np.float32))
            finally:
                BagWriter.write = write  # type: ignore[method-assign]
        return SimpleNamespace(path=path, messages=messages, log=load_log(path))

    @functools.cached_property
    def bags_of_others(self) -> dict[str, str]:
        """Paths of the messages of the bag as others write them, by tool and form."""
        folder = self.folder / "bags"
        found = run("bags", "bags.py", "write", self.bag.path, folder)
        found |= run("npm", "bags.mjs", "write", self.bag.path, folder / "js.mcap")
        return found | run("debian", "debian.py", "write", found["rosbags, ROS 1"], folder)

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
        rng, graph = np.random.default_rng(1), PoseGraph()
        angles = 2.0 * np.pi * np.arange(40) / 40
        truth = np.stack([5.0 * np.cos(angles), 5.0 * np.sin(angles), angles + np.pi / 2], axis=1)
        for pose in truth[::10]:
            graph.add_submap(pose + (rng.normal(0.0, [0.1, 0.1, 0.03]) if graph.num_submaps else 0.0))
        for k, pose in enumerate(truth):
            graph.add_node(pose + rng.normal(0.0, [0.1, 0.1, 0.03]))
            for submap in {k // 10, (k // 10 + 1) % 4, (k // 10 - 1) % 4}:
                base = truth[10 * submap]
                c, s = np.cos(base[2]), np.sin(base[2])
                moved = np.array([[c, s], [-s, c]]) @ (pose - base)[:2]
                relative = np.array([*moved, (pose - base)[2]]) + rng.normal(0.0, 0.02, 3)
                graph.add_constraint(k, submap, relative, np.diag([0.02, 0.05, 0.01]) ** 2)
        view = PoseGraphView(graph.arrays)
        save_g2o(path := self.folder / "graph.g2o", view.nodes, view.edges)
        before = float(chi_squares(graph.arrays).sum())
        while optimise_step(graph.arrays, np.inf) > 1e-10:
            pass
        after = float(chi_squares(graph.arrays).sum())
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
        path = self.folder / "twist.onnx"
        lidarnaut.export_policy("ppo:pretrained/twist", path)
        return path

    @functools.cached_property
    def urdf(self) -> Path:
        return lidarnaut.export_urdf(ROBOT, self.folder / "robot.urdf")
