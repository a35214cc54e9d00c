"""GMapping: particles whose poses are drawn from scan-matched proposals, each with a map of its own."""

import math

import numpy as np

from lidarnaut.envs.estimation import NO_UPDATE, ORIGIN, Belief, MapUpdate
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.pose import distance
from lidarnaut.envs.robots import LidarParams

from ..key_scans import Anchor, KeyScanSlam
from ..matching.correlative import CorrelativeWindow, search_window
from ..matching.covariance import motion_stds, position_std
from ..matching.fields import LEAST_MAP_SHARE, fits_map
from ..matching.scan_matcher import WINDOW_STDS, MatcherParams
from ..params import GMappingParams
from ..posegraph import GrowingArray
from ..relocalization import FOUND_STD, LocalizationMonitor
from ..scans import project_hits
from .particle_maps import ParticleMaps
from .proposal import Proposals, draw_poses, propose, take_better


def normalized_weights(log_weights: np.ndarray) -> np.ndarray:
    """Return weights that add up to 1, shape (n,), float64, from their logarithms up to a common summand."""
    weights: np.ndarray = np.exp(log_weights - log_weights.max())
    return weights / weights.sum()


def systematic_resample(weights: np.ndarray, offset: float) -> np.ndarray:
    """Choose particles by systematic resampling (Kitagawa, Monte Carlo filter and smoother, 1996).

    `weights`, shape (n,), are normalized; `offset` is uniform in [0, 1), the one random number. Returns shape (n,),
    int64, ascending: particle i is chosen n w_i times, rounded down or up.
    """
    n = len(weights)
    return np.minimum(np.searchsorted(np.cumsum(weights), (np.arange(n) + offset) / n, side="right"), n - 1)


def spread(poses: np.ndarray, weights: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return the covariance of weighted poses, shape (n, 3), about their mean: shape (3, 3), float64 [m, rad].

    Headings are taken as turns from that of the pose `around`, so that the wrap at half a turn does no harm.
    """
    apart = poses - reference
    apart[:, 2] = (apart[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    apart -= weights @ apart
    covariance: np.ndarray = (apart * weights[:, None]).T @ apart
    return 0.5 * (covariance + covariance.T)


class GMapping(KeyScanSlam):
    """SLAM by a Rao-Blackwellised particle filter.

    Grisetti, Stachniss and Burgard, Improved techniques for grid mapping with Rao-Blackwellized particle filters, 2007.
    Each particle is a hypothesis of the trajectory with the map that follows from it. At a key scan its pose is drawn
    from a proposal distribution around the pose where the scan fits its map, and its weight is multiplied by the
    likelihood of the scan. Particles are resampled once the effective sample size is low.

    Pose and map of the belief are those of the best particle: the one along whose trajectory the scans are most likely.
    It takes the mode of its proposal distribution, the others draw. When another one becomes the best one, the map is
    redrawn, and `belief.path` holds its trajectory.

    `belief.covariance` is that of the particles. `belief.is_lost` says that scans in succession have not fitted the map
    of the best particle, or that the particles' positions have spread too far. A robot that is lost is searched on that
    map (`relocalization`); meanwhile scans are not integrated, and all particles follow odometry.
    """

    params: GMappingParams
    map: ParticleMaps
    shares_maps = False

    def __init__(self, lidar: LidarParams, params: GMappingParams) -> None:
        """Build a SLAM for one lidar."""
        self._matcher = MatcherParams.of(params)
        self._monitor = LocalizationMonitor(lidar, params.lost_scans)
        super().__init__(lidar, params)

    def reset(self, rng: np.random.Generator, pose: Pose2D = ORIGIN, map: None = None) -> Belief:
        """Start at a known pose with an unknown map; see `KeyScanSlam`.

        Raises:
            ValueError: if a map is given.
        """
        if map is not None:
            raise ValueError("gmapping has a map for each particle, and cannot go on with a given one")
        count = self.params.num_particles
        self.poses = np.tile(np.array(pose, dtype=np.float64), (count, 1))
        """Shape (num_particles, 3), float64: poses at the last key scan, map frame [m, m, rad]."""
        self.log_weights = np.zeros(count)
        """Shape (num_particles,), float64: logarithms of the importance weights since the last resampling."""
        self.log_likelihoods = np.zeros(count)
        """Shape (num_particles,), float64: the same since the reset, along each trajectory."""
        self.best = 0
        """Number of the best particle."""
        self.num_switches = self.num_resamplings = 0
        """How often another particle became the best one, and how often particles were resampled."""
        self._proposals, self._retried = Proposals.make(count), Proposals.make(count)
        # Poses at the key scans as a tree: the particle at the key scan before that each one goes on from.
        self._poses, self._parents = GrowingArray((count, 3), np.float64, 256), GrowingArray((count,), np.int64, 256)
        self._fits = np.ones(count, dtype=np.bool_)
        self._monitor.reset()
        self._is_switched = False
        return super().reset(rng, pose)

    def finish(self) -> None:
        """Write the trajectory of the best particle to `belief.path`, one pose per key scan."""
        particles, particle = np.empty(len(self._poses), dtype=np.int64), self.best
        for k in range(len(particles) - 1, -1, -1):
            particles[k], particle = particle, self._parents.rows[k, particle]
        self.belief.path = self._poses.rows[np.arange(len(particles)), particles]

    @property
    def anchor(self) -> Anchor | None:
        """The last key scan, and the pose as seen from it; None before the first."""
        if self.last_key_pose is None:
            return None
        return Anchor(len(self._poses) - 1, self.last_key_pose.between(self.belief.pose))

    def _make_map(self) -> ParticleMaps:
        return ParticleMaps(self.params, self._lidar)

    def _match(self, ranges: np.ndarray, predicted: Pose2D) -> tuple[Pose2D, float | None]:
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
                self._draw()
                parents = self._weigh()
            else:
                self._move(motion, fallback_pose)
        self._poses.append(self.poses)
        self._parents.append(parents)
        weights, best = normalized_weights(self.log_weights), self.poses[self.best]
        belief.covariance = spread(self.poses, weights, best)
        is_spread = position_std(belief.covariance) > self.params.max_position_std
        belief.is_lost = is_spread or self._monitor.is_lost
        return Pose2D(*best.tolist()), 1.0 if fallback_pose is None else None

    def _propose(self, ranges: np.ndarray, motion: Pose2D) -> bool | None:
        """Find the proposal distribution of each particle after a motion by odometry.

        Returns whether the scan fits the map of the best particle; None where too little of it is known to tell.
        """
        params, resolution = self.params, self.params.resolution
        travelled = distance(motion.x, motion.y)
        stds = motion_stds(self._matcher.odometry_noise, travelled, motion.theta)
        num_points = project_hits(ranges, self.map.geometry, self._points)
        start = motion
        is_far = travelled > self._matcher.search_distance or abs(motion.theta) > self._matcher.search_angle
        if num_points and is_far:
            in_cells = (stds[0] / resolution, stds[1])
            window = CorrelativeWindow(WINDOW_STDS * in_cells[0], WINDOW_STDS * in_cells[1], *in_cells, 50)
            start = self._search(num_points, motion, window)
        over = (self._points, num_points, self._matcher)
        found = self._proposals
        propose(self.map.maps, self.poses, tuple(motion), tuple(start), stds, *over, found)
        is_poor = (found.num_known >= params.min_known_hits) & (found.known_scores < params.retry_below)
        weights = normalized_weights(self.log_weights)
        if weights[is_poor].sum() >= 0.5:
            # The motion model has failed, and with it the covariance that would hold the poses there.
            half_width, half_angle = params.retry_distance / resolution, params.retry_angle
            start = self._search(
                num_points, motion, CorrelativeWindow(half_width, half_angle, 0.5 * half_width, 0.5 * half_angle, 0)
            )
            wide = (params.retry_distance, half_angle)
            propose(self.map.maps, self.poses, tuple(motion), tuple(start), wide, *over, self._retried)
            take_better(found, self._retried, params.retry_gain * num_points)
        self._fits = found.fits
        return fits_map(self.map.grid, self._points[:, :num_points], found.modes[self.best].tolist(), LEAST_MAP_SHARE)

    def _draw(self) -> None:
        """Draw poses from the proposal distributions; the best particle takes the mode."""
        noise = self.rng.standard_normal((len(self.poses), 3))
        noise[self.best] = 0.0
        self.poses = draw_poses(self._proposals, noise)

    def _move(self, motion: Pose2D, pose: Pose2D) -> None:
        """Move the particles by odometry, or to a pose at which the robot was found: the best one there, others near.

        Without a scan that fits, nothing tells the particles apart: weights and maps stay as they are.
        """
        if self._monitor.is_found:
            noise = self.rng.standard_normal((len(self.poses), 3)) * FOUND_STD
            noise[self.best] = 0.0
            self.poses[:] = noise + pose
        else:
            self.poses[:] = [Pose2D(*each).compose(motion) for each in self.poses.tolist()]

    def _search(self, num_points: int, motion: Pose2D, window: CorrelativeWindow) -> Pose2D:
        """Return the motion after which a scan fits the map of the best particle, by a correlative search.

        What odometry errs is the same for all particles, so that one search serves them.
        """
        level, before = min(1, self.params.num_levels - 1), Pose2D(*self.poses[self.best].tolist())
        predicted = before.compose(motion)
        pose = (*self.map.to_cells(predicted.x, predicted.y), predicted.theta)
        occupancy = self.map.occupancy(self.best, level)
        x, y, theta = search_window(occupancy, 0.5**level, self._points, num_points, pose, window)
        return before.between(Pose2D(*self.map.to_metres(x, y), theta))

    def _weigh(self) -> np.ndarray:
        """Weigh the particles, find the best one, and resample if it is time; return the particles' parents."""
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
        # The effective sample size (Grisetti et al., 2007, equation 20) is from 1 to the number of particles.
        if 1.0 / np.square(weights).sum() < params.resample_below * count:
            parents = systematic_resample(weights, self.rng.random())
            self._resample(parents)
        self._is_switched = bool(parents[self.best] != before)
        self.num_switches += self._is_switched
        return parents

    def _resample(self, parents: np.ndarray) -> None:
        """Replace the particles by copies of others; the best one may be lost."""
        self.poses, self._fits = self.poses[parents], self._fits[parents]
        self.log_likelihoods = self.log_likelihoods[parents]
        self.log_weights = np.zeros(len(parents))
        copies = np.flatnonzero(parents == self.best)
        self.best = int(copies[0]) if len(copies) else int(np.argmax(self.log_likelihoods))
        self.map.resample(parents)
        self.num_resamplings += 1

    def _integrate(self, ranges: np.ndarray, pose: Pose2D, quality: float) -> MapUpdate:
        if len(self._poses) == 1:
            # All particles are alike: one map serves them, until they differ.
            self.map.integrate(ranges, self.poses, np.arange(len(self.poses)) == 0)
            self.map.resample(np.zeros(len(self.poses), dtype=np.int64))
        elif self._fits.any():
            self.map.integrate(ranges, self.poses, self._fits)
        elif not self._is_switched:
            return NO_UPDATE
        if self._is_switched:
            self.finish()
        return self.map.render(self.best, self._is_switched)
