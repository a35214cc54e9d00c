"""Local SLAM: scans are matched with the submap that is being built; nothing is corrected later."""

import math
from typing import NamedTuple, Protocol

import numpy as np

from envs.geometry import Pose2D
from envs.geometry.pose import distance
from envs.slam.matching.growing_field import GrowingField
from envs.slam.matching.submap_field import FieldGeometry

from .nodes import MODEL, NodeStore
from .params import GraphSlamParams

Field = tuple[np.ndarray, FieldGeometry]
"""Occupancy in percent, shape (height, width), uint8, and where it lies."""
NOISE_CURVATURE = 0.02
"""Curvature per hit that a field of noise alone shows along x and y [1/cell^2]."""


class Match(NamedTuple):
    """What a scan matcher found."""

    pose: Pose2D
    """In the submap's frame."""
    curvature: np.ndarray
    """Shape (3, 3), float64: sum of g g^T over hits, g the derivative of the field (0 to 1) at a hit by the pose
    [1/m^2, 1/m, 1]."""
    score: float
    """Mean of the field at the hits, from 0 to 1."""


class Matcher(Protocol):
    """Matches a scan with a submap, from a predicted pose on."""

    def __call__(self, fields: list[Field], points: np.ndarray, predicted: Pose2D, prior: np.ndarray) -> Match:
        """Match a scan.

        Args:
            fields: of the submap, the coarse one first.
            points: shape (n, 2), float32, hits in the base frame [m].
            predicted: pose in the submap's frame.
            prior: shape (3, 3), float64: weight of a deviation from the predicted pose against squared differences of
                the field from 1 [1/m^2, 1/rad^2]; zeros for none.
        """
        ...


class LocalSlam:
    """Builds nodes and submaps in the local frame."""

    def __init__(self, params: GraphSlamParams, matcher: Matcher, nodes: NodeStore) -> None:
        """Start at the origin of the local frame; nodes and submaps are added to `nodes`."""
        self._params, self._matcher, self._nodes = params, matcher, nodes
        self.pose = Pose2D(0.0, 0.0, 0.0)
        """Of the base, local frame."""
        self.travelled = 0.0
        """Distance travelled [m]."""
        self.active: list[int] = []
        """Submaps that are being built, the newest last; the first one is matched."""
        self._covariances: dict[int, np.ndarray] = {}
        self._fields: dict[int, list[GrowingField]] = {}
        self._matched = self._node_pose = self.pose

    def update(self, points: np.ndarray, motion: Pose2D) -> int | None:
        """Process hits, shape (n, 2), float32, base frame [m], after a motion; return the new node, if there is one."""
        params = self._params
        self.pose = self.pose.compose(motion)
        self.travelled += distance(motion.x, motion.y)
        step = self._node_pose.between(self.pose)
        is_node = len(self._nodes) == 0 or (
            distance(step.x, step.y) >= params.node_distance or abs(step.theta) >= params.node_angle
        )
        if self.active and (is_node or params.match_every_scan):
            self._match(points)
        return self._add_node(points) if is_node else None

    def covariance(self, submap: int) -> np.ndarray:
        """Return the covariance of a constraint between the last node and a submap that it was integrated into.

        Shape (3, 3), float64, in the submap's frame [m^2, rad^2].
        """
        params = self._params
        least = np.array([params.node_sigma_xy, params.node_sigma_xy, params.node_sigma_theta])
        return params.correlation * self._covariances[submap] + np.diag(least**2)

    def _new_fields(self) -> list[GrowingField]:
        """Return empty fields of a submap, the coarse one first."""
        return [GrowingField(factor * self._params.resolution, *self._nodes.mount, MODEL) for factor in (2.0, 1.0)]

    def _match(self, points: np.ndarray) -> None:
        """Correct the pose by a match, and propagate the covariances of the pose in the active submaps."""
        params, origin = self._params, self._nodes.submap_pose(self.active[0])
        predicted, before = self.pose, self._matched
        moved = before.between(predicted)
        sigma_xy, sigma_theta = params.noise.sigmas(distance(moved.x, moved.y), moved.theta)
        noise = np.diag([sigma_xy**2, sigma_xy**2, sigma_theta**2])
        prior = params.residual_variance * np.linalg.inv(noise)
        fields = [(each.field, each.geometry) for each in self._fields[self.active[0]]]
        match = self._matcher(fields, points, origin.between(predicted), prior)
        self._matched = self.pose = origin.compose(match.pose)
        dx, dy = self.pose.x - before.x, self.pose.y - before.y
        transition = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
        information = _without_noise(match.curvature, len(points), params.resolution) / params.residual_variance
        for submap, covariance in self._covariances.items():
            spread = transition @ covariance @ transition.T + noise
            self._covariances[submap] = np.linalg.inv(np.linalg.inv(spread) + information)

    def _add_node(self, points: np.ndarray) -> int:
        """Add a node at the current pose to the active submaps, and start and finish submaps as they are due."""
        params, nodes = self._params, self._nodes
        if len(nodes) % params.submap_spacing == 0:
            self.active = [*self.active[-1:], nodes.add_submap(self.travelled)]
            self._covariances = {k: self._covariances.get(k, np.zeros((3, 3))) for k in self.active}
            self._fields = {k: self._fields.get(k) or self._new_fields() for k in self.active}
        node = nodes.add_node(points, self.pose, self.active)
        for submap, fields in self._fields.items():
            pose = nodes.submap_pose(submap).between(self.pose)
            for each in fields:
                each.integrate(points, pose)
        self._node_pose = self._matched = self.pose
        return node


def _without_noise(curvature: np.ndarray, num_points: int, resolution: float) -> np.ndarray:
    """Return the curvature of a match without what noise alone would show along x and y."""
    reduced = curvature.copy()
    values, vectors = np.linalg.eigh(curvature[:2, :2])
    kept = np.maximum(values - NOISE_CURVATURE * num_points / resolution**2, 0.0)
    scale = vectors @ np.diag(np.sqrt(kept / np.maximum(values, 1e-12))) @ vectors.T
    reduced[:2, :2] = vectors @ np.diag(kept) @ vectors.T
    reduced[:2, 2] = scale @ curvature[:2, 2]
    reduced[2, :2] = reduced[:2, 2]
    return reduced if math.isfinite(reduced.sum()) else np.zeros((3, 3))
