"""Logs of real robots: reading them, and judging trajectories along them."""

from .log import Log, load_log
from .relations import RelationError, load_relations, relation_error
from .trajectory import compose_poses, follow_odometry, pose_errors, rms, save_trajectory

__all__ = [
    "Log",
    "RelationError",
    "compose_poses",
    "follow_odometry",
    "load_log",
    "load_relations",
    "pose_errors",
    "relation_error",
    "rms",
    "save_trajectory",
]
