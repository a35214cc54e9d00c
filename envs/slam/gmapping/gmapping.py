import math

import numpy as np

from lidarnaut.envs.estimation import NO_UPDATE, Belief, MapUpdate
from lidarnaut.envs.estimation.scan_points import project_hits
from lidarnaut.envs.geometry import ORIGIN, GrowingArray, Pose2D, distance
from lidarnaut.envs.robots import LidarParams

from ..key_scans import KeyScanSlam
from ..matching.correlative import search_window
from ..matching.covariance import motion_stds, position_std
from ..matching.fields import LEAST_MAP_SHARE, fits_map
from ..matching.scan_matcher import MIN_KNOWN_HITS, RETRY_GAIN, MatcherParams
from ..relocalization import FOUND_STD, LocalizationMonitor
from ..slam_params import GMappingParams
from .particle_maps import ParticleMaps
from .proposal import Proposals, draw_poses, propose, take_better


def normalized_weights(log_weights: np.ndarray) -> np.ndarray:
    """Return weights with sum 1, shape (n,), float64, from log weights."""
    weights: np.ndarray = np.exp(log_weights - log_weights.max())
    return weights / weights.sum()


def systematic_resample(weights: np.ndarray, offset: float) -> np.ndarray:
    """Return particle indices by systematic resampling (Kitagawa, Monte Carlo filter and smoother, 1996).

    `weights` have sum 1, shape (n,); `offset` is uniform in [0, 1). Indices have shape (n,), int64, ascending.
    """
    n = len(weights)
    return np.minimum(np.searchsorted(np.cumsum(weights), (np.arange(n) + offset) / n, side="right"), n - 1)


def spread(poses: np.ndarray, weights: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return the covariance, shape (3, 3), float64 [m^2, rad^2], of weighted poses, shape (n, 3) [m, m, rad].

    Headings relative to `reference` avoid wrap-around.
    """
    apart = poses - reference
    apart[:, 2] = (apart[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    apart -= weights @ apart
    covariance: np.ndarray = (apart * weights[:, None]).T @ apart
    return 0.5 * (covariance + covariance.T)


class GMapping(KeyScanSlam):
    """SLAM by a Rao-Blackwellised particle filter.

    Grisetti, Stachniss and Burgard, Improved techniques for grid mapping with Rao-Blackwellized particle filters, 2007.
    A particle is a trajectory with its map. After a minimum motion, particle poses are sampled around scan matches and
    weighted by the scan likelihood. A low effective sample size triggers resampling.

    `belief` has pose and map of the best particle, which has the most likely trajectory and takes proposal means
    instead of samples. When another particle becomes best, the map is redrawn, and `belief.path` is its trajectory.
    `belief.is_lost` is set after consecutive scans that do not fit the map, or at high position spread. A lost robot is
    searched on the best map.
    """

    params: GMappingParams
    map: ParticleMaps
    shares_maps = False

    def __init__(self, lidar: LidarParams, params: GMappingParams) -> None:
        self._matcher = MatcherParams.of(params)
        self._monitor = LocalizationMonitor(params.limited(lidar))
        super().__init__(lidar, params)

    def reset(self, rng: np.random.Generator, pose: Pose2D = ORIGIN, map: None = None) -> Belief:
        count = self.params.num_particles
        self.poses = np.tile(np.array(pose, dtype=np.float64), (count, 1))
        """Particle poses at the last matched scan, shape (num_particles, 3), map frame [m, m, rad]."""
        self.log_weights = np.zeros(count)
        self.log_likelihoods = np.zeros(count)
        self.best = 0
        """Index of the particle with the most likely trajectory."""
        self.num_switches = self.num_resamplings = 0
        self._proposals, self._retried = Proposals.make(count), Proposals.make(count)
        # Tree of poses at key scans, with parent particles.
        self._poses, self._parents = GrowingArray((count, 3), np.float64, 256), GrowingArray((count,), np.int64, 256)
        self._fits = np.ones(count, dtype=np.bool_)
        self._monitor.reset()
        self._is_switched = False
        return super().reset(rng, pose, map)

    def finish(self) -> None:
        """Write the best particle's trajectory, one pose per matched scan, to `belief.path`."""
        particles, particle = np.empty(len(self._poses), dtype=np.int64), self.best
        for k in range(len(particles) - 1, -1, -1):
            particles[k], particle = particle, self._parents.rows[k, particle]
        self.belief.path = self._poses.rows[np.arange(len(particles)), particles]

    @property
    def anchor(self) -> tuple[int, Pose2D] | None:
        """Robot pose relative to the last matched scan; None before the first."""
        if self.last_key_pose is None:
            return None
        return len(self._poses) - 1, self.last_key_pose.between(self.belief.pose)

    def make_map(self) -> ParticleMaps:
        return ParticleMaps(self.params, self._lidar)

    def match(self, ranges: np.ndarray, predicted: Pose2D) -> tuple[Pose2D, float | None]:
        last, belief = self.last_key_pose, self.belief
        self._is_switched, belief.path = False, None
        parents, fallback_pose = np.arange(len(self.poses)), None
        if last is None:
            self.poses[:] = predicted
        else:
            motion = last.between(predicted)
            fits = self._propose(ranges, motion)
            mode = Pose2D(*self._proposals.modes[self.best].tolist())
            fallback_pose = self._monitor.update(ranges, predicted, mode, fits, belief.grid)
            if fallback_pose is None:
                noise = self.rng.standard_normal((len(self.poses), 3))
                noise[self.best] = 0.0
                self.poses = draw_poses(self._proposals, noise)
                parents = self._weigh()
            else:
                self._move(motion, fallback_pose)
        self._poses.append(self.poses)
        self._parents.append(parents)
        weights, best = normalized_weights(self.log_weights), self.poses[self.best]
        belief.covariance = spread(self.poses, weights, best)
        belief.is_lost = position_std(belief.covariance) > self.params.max_position_std or self._monitor.is_lost
        return Pose2D(*best.tolist()), 1.0 if fallback_pose is None else None

    def _propose(self, ranges: np.ndarray, motion: Pose2D) -> bool | None:
        params, resolution, matcher = self.params, self.params.resolution, self._matcher.in_contact(self.slip)
        travelled = distance(motion.x, motion.y)
        stds = motion_stds(matcher.odometry_noise, travelled, motion.theta)
        num_points = project_hits(ranges, self.map.geometry, self._points)
        start = motion
        is_far = travelled > matcher.search_distance or abs(motion.theta) > matcher.search_angle
        if num_points and is_far:
            start = self._search(num_points, motion, (stds[0] / resolution, stds[1]), 50)
        over = (self._points, num_points, self._matcher)
        found = self._proposals
        propose(self.map.maps, self.poses, tuple(motion), tuple(start), stds, *over, found)
        is_poor = (found.num_known >= MIN_KNOWN_HITS) & (found.known_scores < params.retry_below)
        weights = normalized_weights(self.log_weights)
        if weights[is_poor].sum() >= 0.5:
            # The motion model failed, and its covariance is too small.
            wide = (params.retry_distance, params.retry_angle)
            start = self._search(num_points, motion, (0.5 * (wide[0] / resolution), 0.5 * wide[1]), 0)
            propose(self.map.maps, self.poses, tuple(motion), tuple(start), wide, *over, self._retried)
            take_better(found, self._retried, RETRY_GAIN * num_points)
        self._fits = found.fits
        if self.observers:
            costs = num_points - found.num_known * found.known_scores
            tested = [(Pose2D(*mode), cost) for mode, cost in zip(found.modes.tolist(), costs.tolist())]
            predicted = Pose2D(*self.poses[self.best].tolist()).compose(motion)
            for observer in self.observers:
                observer(predicted, tested, tested[self.best])
        return fits_map(self.map.grid, self._points[:, :num_points], found.modes[self.best].tolist(), LEAST_MAP_SHARE)

    def _move(self, motion: Pose2D, pose: Pose2D) -> None:
        if self._monitor.is_found:
            noise = self.rng.standard_normal((len(self.poses), 3)) * FOUND_STD
            noise[self.best] = 0.0
            self.poses[:] = noise + pose
        else:
            self.poses[:] = [Pose2D(*each).compose(motion) for each in self.poses.tolist()]

    def _search(self, num_points: int, motion: Pose2D, stds: tuple[float, float], unknown: int) -> Pose2D:
        level, before = min(1, self.params.num_levels - 1), Pose2D(*self.poses[self.best].tolist())
        predicted = before.compose(motion)
        pose = (*self.map.to_cells(predicted.x, predicted.y), predicted.theta)
        occupancy = self.map.occupancy(self.best, level)
        x, y, theta = search_window(occupancy, 0.5**level, self._points, num_points, pose, stds, unknown)
        return before.between(Pose2D(*self.map.to_metres(x, y), theta))

    def _weigh(self) -> np.ndarray:
        params, count = self.params, len(self.poses)
        gained = params.likelihood_gain * self._proposals.log_likelihoods
        self.log_weights += gained
        self.log_likelihoods += gained
        candidate = int(np.argmax(self.log_likelihoods))
        before = self.best
        if self.log_likelihoods[candidate] > self.log_likelihoods[before] + params.switch_margin:
            self.best = candidate
        parents = np.arange(count)
        weights = normalized_weights(self.log_weights)
        # Effective sample size (Grisetti et al., 2007, equation 20), from 1 to the number of particles.
        if 1.0 / np.square(weights).sum() < params.resample_below * count:
            parents = systematic_resample(weights, self.rng.random())
            self._resample(parents)
        self._is_switched = bool(parents[self.best] != before)
        self.num_switches += self._is_switched
        return parents

    def _resample(self, parents: np.ndarray) -> None:
        self.poses, self._fits = self.poses[parents], self._fits[parents]
        self.log_likelihoods = self.log_likelihoods[parents]
        self.log_weights = np.zeros(len(parents))
        copies = np.flatnonzero(parents == self.best)
        self.best = int(copies[0]) if len(copies) else int(np.argmax(self.log_likelihoods))
        self.map.resample(parents)
        self.num_resamplings += 1

    def _integrate(self, ranges: np.ndarray, pose: Pose2D, quality: float) -> MapUpdate:
        if len(self._poses) == 1:
            # All particles are equal after the first scan and share a map.
            self.map.integrate(ranges, self.poses, np.arange(len(self.poses)) == 0)
            self.map.resample(np.zeros(len(self.poses), dtype=np.int64))
        elif self._fits.any():
            self.map.integrate(ranges, self.poses, self._fits)
        elif not self._is_switched:
            return NO_UPDATE
        if self._is_switched:
            self.finish()
        return self.map.render(self.best, self._is_switched)
