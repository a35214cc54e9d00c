"""Logs of real robots, and evaluation of trajectories."""

from .log import Log, load_log
from .relations import RelationError, load_relations, relation_error
from .trajectory import compose_poses, follow_odometry, rms, save_trajectory, trajectory_errors

__all__ = [
    "Log",
    "RelationError",
    "compose_poses",
    "follow_odometry",
    "load_log",
    "load_relations",
    "relation_error",
    "rms",
    "save_trajectory",
    "trajectory_errors",
]
