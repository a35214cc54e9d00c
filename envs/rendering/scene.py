"""Scenes: data of one moment of an episode."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.navigation import Markers
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.slam import MatcherTrace, PoseGraphView
from lidarnaut.envs.worlds import World


@dataclass(slots=True, kw_only=True)
class Scene:
    """One moment of an episode: ground truth, and the robot's map and pose estimate."""

    world: World
    robot: RobotParams
    pose: Pose2D
    """True pose of the base, world frame."""
    trail: np.ndarray
    """True path, shape (n, 2), world frame [m]."""
    ranges: np.ndarray
    """Last scan, shape (num_beams,), float32 [m]."""
    plan: np.ndarray | None
    """Planned path, shape (n, 2), map frame [m]."""
    time: float
    """Time since the reset [s]."""
    collisions: int
    """Number of collisions of all robots since the reset."""
    start: Pose2D
    """Pose of the map frame in the world frame."""
    people: np.ndarray
    """True people: x, y [m], vx, vy [m/s], radius [m], shape (n, 5), float64, world frame."""
    tracks: np.ndarray
    """Tracked people: x, y, vx, vy, radius, shape (n, 5), map frame [m, m/s]."""
    belief: Belief
    estimated_trail: np.ndarray
    """Estimated path, shape (n, 2), map frame [m]."""
    progress: float
    """Share of the task completed, from 0 to 1."""
    progress_label: str = "explored"
    goal: Pose2D | None = None
    """Goal pose, map frame."""
    particles: np.ndarray | None = None
    """Particles of the localizer x, y, heading, shape (n, 3), map frame [m, m, rad]."""
    has_known_map: bool = False
    pose_graph: PoseGraphView | None = None
    markers: Markers | None = None
    """Goals and random trees that the policy considers."""
    tested: np.ndarray | None = None
    """Poses tested for the last scan x, y, heading, and their costs, shape (n, 4), map frame [m, m, rad]."""
    peers: tuple["Scene", ...] = ()

    @property
    def estimated_pose(self) -> Pose2D:
        return self.start.compose(self.belief.pose)

    @property
    def pose_error(self) -> tuple[float, float]:
        """Maximum absolute position [m] and heading [rad] error of all robots."""
        errors = [scene.estimated_pose.between(scene.pose) for scene in (self, *self.peers)]
        return max(math.hypot(error.x, error.y) for error in errors), max(abs(error.theta) for error in errors)


def people_in(tracks: np.ndarray, frame: Pose2D) -> np.ndarray:
    """Transform people (x, y, vx, vy, radius), shape (n, 5) [m, m/s], from the frame at pose `frame` to its parent."""
    velocities = Pose2D(0.0, 0.0, frame.theta).transform(tracks[:, 2:4])
    return np.column_stack([frame.transform(tracks[:, :2]), velocities, tracks[:, 4]])


def scene_of(env: Any, k: int) -> Scene:
    """Return the current scene (data of a picture) of robot `k` in an environment."""
    robot, truth, task = env.robots[k], env.truths[k], env.task
    estimator = robot.estimator
    pose_graph, plan = estimator.pose_graph, env.overlay.plans[k]
    traces = (one for one in estimator.observers or () if isinstance(one, MatcherTrace))
    return Scene(
        world=env.world,
        robot=robot.params,
        pose=truth.state.pose,
        start=env.map_pose,
        people=env.simulator.people,
        tracks=env.overlay.tracks,
        belief=robot.belief,
        ranges=robot.reading.ranges,
        trail=truth.trail.positions,
        estimated_trail=robot.trail.positions,
        plan=getattr(task, "route_ahead", None) if plan is None else plan,
        progress=float(task.metrics()[task.progress]),
        progress_label=task.progress.removesuffix("_fraction").replace("_", " "),
        time=env.time,
        collisions=sum(other.collisions for other in env.robots),
        goal=task.goal,
        particles=estimator.particles,
        has_known_map=robot.has_known_map,
        pose_graph=pose_graph if isinstance(pose_graph, PoseGraphView) else None,
        markers=env.overlay.markers() if k == 0 and env.overlay.markers else None,
        tested=next((np.reshape(one.tested, (-1, 4)) for one in traces), None),
    )
