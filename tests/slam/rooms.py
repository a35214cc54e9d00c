import numpy as np

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.raycast import Beams, cast_rays
from lidarnaut.envs.robots import LidarParams, Mount, OdometryNoise
from lidarnaut.envs.simulation import Reading
from lidarnaut.envs.slam import HectorParams, load_params, make_slam
from lidarnaut.envs.slam.log_odds_map import LogOddsMap
from lidarnaut.envs.slam.matching.fields import Field

LIDAR = LidarParams(num_beams=180, range_max=6.0, mount=Mount(x=-0.05, y=0.02, yaw=0.1))
STAY = Pose2D(0.0, 0.0, 0.0)
# A room of 6 m x 5 m with a box, around the start.
ROOM = [(-3, -2, 3, -2), (3, -2, 3, 3), (3, 3, -3, 3), (-3, 3, -3, -2)]
BOX = [(1, 0.5, 1.6, 0.7), (1.6, 0.7, 1.3, 1.4), (1.3, 1.4, 1, 0.5)]
CIRCLE = [Pose2D(0.02, 0.0, 0.015)] * 400  # about one turn
BY_WHEELS = [Pose2D(0.0206, 0.0002, 0.0165)] * 400  # distances 3 % too long, turns 10 % too large
WHEELS = OdometryNoise(0.005, 0.05, 0.005, 0.12, 0.05)
CORRIDOR = [(-50, -1, 50, -1), (-50, 1, 50, 1)]
ELSEWHERE = [(-0.5, -0.4, 0.5, -0.4), (0.5, -0.4, 0.5, 0.4), (0.5, 0.4, -0.5, 0.4), (-0.5, 0.4, -0.5, -0.4)]
SMALL = {
    "tinyslam": {},
    "hector": {"map_width": 20.0, "map_height": 20.0, "min_travel_angle": 0.3},
    "gmapping": {"map_width": 10.0, "map_height": 10.0, "num_particles": 10},
}


NO_CIRCLES = np.empty((0, 3))


def make_small(name, preset="default", noise=WHEELS, **changes):
    return make_slam(name, LIDAR, 0.05, load_params(preset, SMALL[name] | changes, name), noise)


def scan(pose, rng=None, noise=0.01, walls=ROOM + BOX, lidar=LIDAR, circles=NO_CIRCLES):
    out = np.empty(lidar.num_beams, dtype=np.float32)
    sensor = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, lidar.mount.yaw))
    beams = Beams(lidar.angle_min, lidar.angle_increment, lidar.range_max)
    cast_rays(*sensor, beams, np.array(walls, dtype=float), circles, out)
    return out if rng is None else (out + rng.normal(0.0, noise, out.shape)).astype(np.float32)


def see(pose, *args, **kwargs):
    return Reading.of_scan(scan(pose, *args, **kwargs))


def follow(slam, motions, rng=None, pose=STAY):
    """Yield the true pose and the belief at the start and after each motion, with exact odometry."""
    for motion in [STAY, *motions]:
        pose = pose.compose(motion)
        yield pose, slam.update(see(pose, rng), motion)


def drive(slam, motions, odometry, seed=0, walls=ROOM + BOX):
    """Return the true and the estimated pose after the motions, with wrong `odometry`."""
    rng = np.random.default_rng(seed)
    slam.reset(np.random.default_rng(seed + 1))
    pose = STAY
    slam.update(see(pose, rng, walls=walls), STAY)
    for motion, measured in zip(motions, odometry):
        pose = pose.compose(motion)
        slam.update(see(pose, rng, walls=walls), measured)
    return pose, slam.belief.pose


def wall_distances(points, segments, circles=()):
    """Distance from points, shape (n, 2), to the nearest wall, shape (n,) [m]."""
    a, b = segments[:, None, :2], segments[:, None, 2:]
    t = np.clip(((points - a) * (b - a)).sum(2) / ((b - a) ** 2).sum(2), 0.0, 1.0)
    gaps = list(np.hypot(*np.moveaxis(points - a - t[..., None] * (b - a), 2, 0)))
    gaps += [np.abs(np.hypot(*(points - circle[:2]).T) - circle[2]) for circle in circles]
    return np.min(gaps, axis=0)


def rectangle(x0, y0, x1, y1):
    return np.array([[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]], dtype=float)


FLAT = np.concatenate([rectangle(0.0, 0.0, 6.0, 4.0), rectangle(4.0, 1.0, 4.6, 1.5), [[2.0, 4.0, 2.0, 2.8]]])
"""Room of 6 m x 4 m with a box and a partition, shape (9, 4) [m]."""


def visible_points(walls, pose, num_beams, range_max):
    """Return the hits of beams of a lidar at a pose, shape (n, 2), float32, base frame [m]."""
    lidar = LidarParams(num_beams=num_beams, range_max=range_max)
    ranges = scan(Pose2D(*pose), walls=walls, lidar=lidar)
    hit = ranges < range_max
    return (ranges[hit] * lidar.directions[:, hit]).T.astype(np.float32)


def render_field(walls, poses, num_beams=180, range_max=10.0, seed=0):
    rng, lidar = np.random.default_rng(seed), LidarParams(num_beams=num_beams, range_max=range_max)
    map = LogOddsMap(HectorParams(num_levels=1, skip_exceeding=True), lidar)
    for pose in poses:
        map.integrate(scan(Pose2D(*pose), rng, walls=walls, lidar=lidar), Pose2D(*pose))
    return Field.of(map.grid)
