"""Scenes: the content of a picture."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.slam import PoseGraphView
from lidarnaut.envs.worlds import World


@dataclass(slots=True, kw_only=True)
class Scene:
    """One moment of an episode: the ground truth in the world frame, and the robot's map and pose estimate."""

    world: World
    robot: RobotParams
    pose: Pose2D
    """True pose of the robot's base, world frame."""
    trail: np.ndarray
    """True positions so far, shape (n, 2), world frame [m]."""
    ranges: np.ndarray
    """Last scan, shape (num_beams,), float32 [m], as `Reading.ranges`."""
    plan: np.ndarray | None
    """Planned path, shape (n, 2), map frame [m]; None without one."""
    time: float
    """Time since the reset [s]."""
    collisions: int
    """Contacts so far, of all robots."""
    start: Pose2D
    """World pose of the map frame's origin: `start.compose` carries poses of the map frame into the world frame."""
    people: np.ndarray
    """People, shape (n, 5), float64: x, y, radius [m], vx, vy [m/s], world frame."""
    tracks: np.ndarray
    """People whom the robot tracks, shape (n, 5): x, y, vx, vy, radius, map frame [m, m/s]."""
    belief: Belief
    """Pose estimate and map, map frame."""
    estimated_trail: np.ndarray
    """Estimated positions so far, shape (n, 2), map frame [m]."""
    progress: float
    """Share of the task that is done, from 0 to 1."""
    progress_label: str = "explored"
    """What it is called."""
    goal: Pose2D | None = None
    """Where to go, map frame; None without a goal."""
    particles: np.ndarray | None = None
    """Particles of the localizer, shape (n, 3): x, y, heading, map frame [m, m, rad]; None without any."""
    has_known_map: bool = False
    """Whether the robot was given the map."""
    pose_graph: PoseGraphView | None = None
    """Nodes and loop closures of a SLAM that has any."""
    peers: tuple["Scene", ...] = ()
    """The other robots of the team, which share world and map."""

    @property
    def estimated_pose(self) -> Pose2D:
        """Estimated pose of the robot's base, world frame."""
        return self.start.compose(self.belief.pose)

    @property
    def pose_error(self) -> tuple[float, float]:
        """Distance [m] and angle [rad] between estimated and true pose, not negative; the greatest of all robots."""
        errors = [scene.estimated_pose.between(scene.pose) for scene in (self, *self.peers)]
        return max(math.hypot(error.x, error.y) for error in errors), max(abs(error.theta) for error in errors)


def people_in(tracks: np.ndarray, frame: Pose2D) -> np.ndarray:
    """Carry people, shape (n, 5), x, y, vx, vy, radius [m, m/s], out of a frame into the one in which it is given."""
    velocities = Pose2D(0.0, 0.0, frame.theta).transform(tracks[:, 2:4])
    return np.column_stack([frame.transform(tracks[:, :2]), velocities, tracks[:, 4]])


def scene_of(env: Any, k: int) -> Scene:
    """Return the moment of a `LidarEnv` as one of its robots takes part in it."""
    robot, truth, task = env.robots[k], env.truths[k], env.task
    estimator = robot.estimator
    pose_graph = getattr(estimator, "pose_graph", None)
    plan = env.plans[k]
    return Scene(
        world=env.world,
        robot=robot.params,
        pose=truth.state.pose,
        start=env.map_pose,
        people=env.simulator.people,
        tracks=env.tracks,
        belief=robot.belief,
        ranges=robot.reading.ranges,
        trail=truth.trail.positions,
        estimated_trail=robot.trail.positions,
        plan=getattr(task, "route_ahead", None) if plan is None else plan,
        progress=float(task.metrics()[task.progress]),
        progress_label=task.progress.removesuffix("_fraction").replace("_", " "),
        time=env.time,
        collisions=sum(other.collisions for other in env.robots),
        goal=getattr(task, "goal", None),
        particles=getattr(estimator, "particles", None),
        has_known_map=env.priors[k].map is not None,
        pose_graph=pose_graph if isinstance(pose_graph, PoseGraphView) else None,
    )
