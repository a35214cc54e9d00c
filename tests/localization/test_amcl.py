import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from lidarnaut.benchmarks.drives.localization import load_reference, measure_filter, reference_map
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.localization import PRESETS, Amcl, AmclParams, load_preset
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.simulation import Reading
from lidarnaut.envs.worlds import World, rasterize
from tests.data import INTEL, needs_intel
from tests.slam.rooms import scan

LIDAR = LidarParams(180, 6.0)
# An L-shaped room with a pillar: no two poses look alike.
CORNERS = [(0, 0), (7, 0), (7, 3), (4, 3), (4, 5), (0, 5)]
SEGMENTS = np.array([(*a, *b) for a, b in zip(CORNERS, CORNERS[1:] + CORNERS[:1])], dtype=float) + 0.025
CIRCLES = np.array([[2.0, 3.5, 0.3]])
ROOM = World("room", SEGMENTS, CIRCLES, (Pose2D(1.0, 1.0, 0.0),), (0.0, 0.0, 7.05, 5.05))
MAP = rasterize(ROOM, 0.05)
PARAMS = replace(PRESETS["default"], global_particles=20_000)
SURE = np.diag([0.05**2, 0.05**2, 0.05**2])


def see(pose, segments=SEGMENTS):
    return Reading.of_scan(scan(pose, walls=segments, lidar=LIDAR, circles=CIRCLES))


START = Pose2D(1.5, 1.0, 0.2)


def started(seed=0, pose=START, grid=MAP, covariance=SURE, params=PARAMS, **changes):
    """Localizer at a well-known pose; None: global localization."""
    amcl = Amcl(LIDAR, replace(params, **changes))
    amcl.reset(np.random.default_rng(seed), pose, grid, covariance)
    return amcl


def changed_map(change):
    """Return the map of the room after `change(data, row, col)`; row and column are those of the start."""
    grid = OccupancyGrid(MAP.data.copy(), MAP.resolution, MAP.origin)
    change(grid.data, *grid.cells(np.array(START[:2])))
    return grid


def distance(amcl, pose):
    return math.dist(amcl.belief.pose[:2], pose[:2])


def circle(steps=100, start=START):
    """Yield true poses and slightly wrong odometry."""
    pose = start
    rng = np.random.default_rng(9)
    yield pose, Pose2D(0.0, 0.0, 0.0)
    for _ in range(steps):
        motion = Pose2D(0.05, 0.0, 0.1)
        pose = pose.compose(motion)
        slip = 1.0 + 0.03 * rng.standard_normal(2)
        yield pose, Pose2D(motion.x * slip[0], 0.0, motion.theta * slip[1])


def _follow(amcl, steps=100, **kwargs):
    errors = []
    for pose, motion in circle(steps):
        estimate = amcl.update(see(pose, **kwargs), motion)
        off = estimate.pose.between(pose)
        errors.append((math.hypot(off.x, off.y), abs(off.theta)))
    return np.array(errors), estimate


def test_a_posterior_known_by_hand():
    """Three beams ahead and a wall: the particles have to match the posterior computed cell by cell."""
    data = np.zeros((21, 60), dtype=np.int8)
    data[:, 50] = 100
    grid = OccupancyGrid(data, 0.1, (0.0, 0.0))
    lidar = LidarParams(3, 8.0, fov=1e-3)
    flags = {"sensor": "likelihood_field_prob", "max_beams": 3, "sigma_hit": 0.2, "max_distance": 1.5}
    amcl = Amcl(lidar, AmclParams(min_particles=20_000, max_particles=20_000, **flags))
    prior_std = 0.4
    covariance = np.diag([prior_std**2, 1e-8, 1e-10])
    amcl.reset(np.random.default_rng(3), Pose2D(2.85, 1.05, 0.0), grid, covariance)
    amcl.update(Reading.of_scan(np.full(3, 2.0, dtype=np.float32)), Pose2D(0.0, 0.0, 0.0))
    x = np.linspace(1.0, 4.8, 4001)
    ends = np.floor((x + 2.0) / 0.1)
    distance = np.minimum(0.1 * np.abs(ends - 50), 1.5)
    pz = 0.5 * np.exp(-(distance**2) / (2 * 0.2**2)) + 0.5 / 8.0
    posterior = np.exp(-0.5 * ((x - 2.85) / prior_std) ** 2) * pz**3
    posterior /= posterior.sum()
    mean = (posterior * x).sum()
    x_drawn = amcl.particles[:, 0]
    assert x_drawn.mean() == pytest.approx(mean, abs=0.01)
    assert x_drawn.var() == pytest.approx((posterior * (x - mean) ** 2).sum(), rel=0.06)
    assert abs(mean - 2.85) > 0.1  # the scan is informative


@pytest.mark.parametrize("sensor", ["likelihood_field", "likelihood_field_prob", "beam"])
def test_tracking(sensor):
    amcl = started(0, sensor=sensor, max_particles=1000, max_beams=30)
    errors, estimate = _follow(amcl)
    rms = np.sqrt(np.mean(errors**2, axis=0))
    assert rms[0] < (0.15 if sensor == "likelihood_field" else 0.05)
    assert rms[1] < (0.1 if sensor == "likelihood_field" else 0.03)
    assert amcl.fit > 0.9
    assert estimate.is_lost is False
    assert np.linalg.eigvalsh(estimate.covariance)[0] >= 0
    assert amcl.particles.shape == (amcl.num_particles, 3)
    assert amcl._weights.sum() == pytest.approx(1.0)


def test_global_localization_and_the_cloud_shrinks():
    amcl = started(1, None)
    assert amcl.belief.is_lost
    assert amcl.num_particles == 20_000
    assert math.isnan(amcl.fit)
    free = MAP.data[tuple(MAP.cells(amcl.particles[:, :2]).T)] == 0
    assert free.mean() > 0.999  # rounding may put one on the border of its cell
    errors, estimate = _follow(amcl)
    assert errors[-1, 0] < 0.1
    assert not estimate.is_lost
    assert amcl.cluster_weight > 0.95
    assert amcl.num_particles < 1000


def test_same_seed_same_bytes():
    clouds = []
    for seed in (7, 7, 8):
        amcl = started(seed, None)
        _, estimate = _follow(amcl, 20)
        clouds.append((amcl.particles.tobytes(), estimate.pose))
    assert clouds[0] == clouds[1] != clouds[2]


@pytest.mark.parametrize("changes", [{}, {"relocalize": False, "alpha_slow": 0.02, "alpha_fast": 0.5}])
def test_a_kidnapped_robot_relocalizes(changes):
    amcl = started(2, **changes)
    _, estimate = _follow(amcl, 60)
    assert not estimate.is_lost
    was_lost = []
    for pose, motion in circle(250, Pose2D(5.2, 0.8, 0.3)):
        was_lost.append(amcl.update(see(pose), motion).is_lost)
    assert any(was_lost[:60])
    assert distance(amcl, pose) < 0.2
    assert not was_lost[-1]


@pytest.mark.parametrize(("relocalize", "start"), [(False, START), (True, None)])
def test_a_map_of_another_world_makes_it_lost_and_the_right_one_does_not(relocalize, start):
    # A narrow zigzag unlike the room of the map.
    x = np.linspace(-1.0, 4.0, 21)
    teeth = np.stack([x, 0.6 + 0.35 * (np.arange(21) % 2)], axis=1)
    low, high = (np.column_stack([row[:-1], row[1:]]) for row in (teeth, teeth + (0.0, 1.6)))
    for segments, expected in ((np.vstack([low, high, SEGMENTS]), True), (SEGMENTS, False)):
        amcl = started(4, start, relocalize=relocalize, lost_distance=0.1)
        _, estimate = _follow(amcl, segments=segments)
        assert estimate.is_lost is expected, amcl.fit


@pytest.mark.parametrize(
    ("params", "is_known"),
    [
        (PRESETS["nav2"], True),
        (PRESETS["turtlebot3"], False),
        (PRESETS["default"], False),
        (replace(PARAMS, sensor="beam", max_particles=600, max_beams=15), True),
    ],
)
def test_it_does_not_matter_where_the_map_lies(params, is_known):
    found = []
    for x, y in ((0.0, 0.0), (4.5e5, 5.4e6), (-1e7, 1e7)):
        moved = OccupancyGrid(MAP.data, MAP.resolution, (MAP.origin[0] + x, MAP.origin[1] + y))
        start = Pose2D(START.x + x, START.y + y, START.theta) if is_known else None
        amcl, rows = started(0, start, moved, params=params, global_particles=None), []
        for pose, motion in circle(25):
            belief = amcl.update(see(pose), motion)
            rows.append((belief.pose.x - x, belief.pose.y - y, belief.pose.theta, belief.is_lost))
        found.append(rows)
        mean = np.average(amcl.particles[:, :2], axis=0, weights=amcl._weights)
        assert amcl.particles.dtype == np.float64
        assert np.abs(mean - belief.pose[:2]).max() < (0.1 if is_known else 5.0)
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=0.0, atol=1e-6)


NOTHING = np.full(LIDAR.num_beams, np.inf, dtype=np.float32)
FEW = np.where(np.arange(LIDAR.num_beams) % 60 == 0, np.float32(1.0), NOTHING)


@pytest.mark.parametrize(
    ("name", "jump", "blind", "spread"),
    [
        ("nav2", Pose2D(50.0, 0.0, 0.0), None, 0.05),  # off the map
        ("default", Pose2D(1e12, -1e12, 0.0), None, 0.05),
        ("default", Pose2D(50.0, 0.0, 0.0), NOTHING, 0.05),
        ("nav2", Pose2D(50.0, 0.0, 0.0), FEW, 3.0),  # a spread cloud, and too few hits to judge it
        ("default", Pose2D(50.0, 0.0, 0.0), NOTHING * np.float32(np.nan), 3.0),
        ("default", Pose2D(-1.5, -1.5, 0.0), None, 0.0),  # into the unknown outside of the room
    ],
)
def test_a_filter_whose_particles_have_all_left_the_free_space_starts_anew(name, jump, blind, spread):
    unknown = np.pad(MAP.data, 40, constant_values=-1)
    grid = OccupancyGrid(unknown, MAP.resolution, (MAP.origin[0] - 2.0, MAP.origin[1] - 2.0))
    noise = {"max_particles": 5000, "alpha3": 0.01, "alpha2": 0.01}
    amcl = started(grid=grid, covariance=np.diag([spread**2, spread**2, 0.01]), params=PRESETS[name], **noise)
    amcl.update(see(START), Pose2D(0.0, 0.0, 0.0))
    amcl.update(see(START), jump)
    lost = []
    for pose, motion in itertools.islice(circle(400), 1, 400):
        reading = see(pose) if blind is None or len(lost) > 60 else Reading.of_scan(blind)
        lost.append(amcl.update(reading, motion).is_lost)
    assert all(lost[:10])
    assert not lost[-1]
    assert distance(amcl, pose) < 0.3


def test_a_robot_in_a_gap_of_the_map_that_its_scans_fit_is_tracked():
    def forget_beyond(data, row, col):
        data[:, col + 5 :][data[:, col + 5 :] == 0] = -1

    amcl = started(grid=changed_map(forget_beyond))
    for pose, motion in itertools.islice(circle(60), 60):
        assert not amcl.update(see(pose), motion).is_lost
        assert distance(amcl, pose) < 0.1


def test_a_robot_that_stands_still_only_follows_odometry():
    amcl = started(5, update_min_d=0.2, update_min_a=0.2)
    poses, clouds, corrected = [], [], []
    for motion in (Pose2D(0.0, 0.0, 0.0), Pose2D(0.1, 0.0, 0.1), Pose2D(0.15, 0.0, 0.0)):
        poses.append(amcl.update(see(START), motion).pose)
        clouds.append(amcl.particles.tobytes())
        corrected.append(amcl.is_corrected)
    assert corrected == [True, False, True]
    np.testing.assert_allclose(poses[1], poses[0].compose(Pose2D(0.1, 0.0, 0.1)))
    assert clouds[0] == clouds[1] != clouds[2]


def test_resample_interval_keeps_weights_in_between():
    amcl, resampled = started(5, resample_interval=3), []
    for pose, motion in circle(40):
        amcl.update(see(pose), motion)
        if amcl.is_corrected:
            resampled.append(bool(np.ptp(amcl._weights) < 1e-12))
    assert resampled[:9] == [False, False, True] * 3


@pytest.mark.parametrize("sensor", ["likelihood_field", "likelihood_field_prob", "beam"])
def test_beams_that_say_nothing(sensor):
    amcl = started(6, sensor=sensor, max_particles=600)
    nothing = np.full(LIDAR.num_beams, np.nan, dtype=np.float32)
    estimate = amcl.update(Reading.of_scan(nothing), Pose2D(0.0, 0.0, 0.0))
    spread = estimate.covariance[0, 0]
    estimate = amcl.update(Reading.of_scan(nothing), Pose2D(0.5, 0.0, 0.0))
    assert estimate.pose.x == pytest.approx(1.5 + 0.5 * math.cos(0.2), abs=0.03)
    assert estimate.covariance[0, 0] > spread
    assert math.isnan(amcl.fit)
    reading = see(START.compose(Pose2D(0.7, 0.0, 0.0)))
    reading.ranges[::3] = np.nan
    reading.ranges[1::3] = np.inf if sensor != "beam" else np.nan
    estimate = amcl.update(reading, Pose2D(0.2, 0.0, 0.0))
    assert np.isfinite(estimate.covariance).all()
    assert estimate.covariance[0, 0] < 0.1
    assert np.isfinite(amcl._weights).all()


def test_a_covariance_turns_the_cloud():
    covariance = np.array([[0.04, 0.03, 0.0], [0.03, 0.04, 0.01], [0.0, 0.01, 0.02]])
    estimate = started(pose=Pose2D(1.5, 1.0, 3.1), covariance=covariance, max_particles=50_000).belief
    np.testing.assert_allclose(estimate.covariance, covariance, atol=2e-3)
    assert math.cos(estimate.pose.theta - 3.1) > 0.9999
    usual = started(pose=Pose2D(1.5, 1.0, 0.0), covariance=None, max_particles=50_000).particles
    np.testing.assert_allclose(np.sqrt(np.cov(usual.T).diagonal()), [0.5, 0.5, math.radians(15)], rtol=0.03)


@needs_intel
def test_the_beginning_of_the_intel_log():
    log, drive = load_reference(INTEL / "scans_2725.npz", 400)
    grid = reference_map(log.lidar, drive)
    measures = measure_filter(drive, log.lidar, grid, replace(PARAMS, relocalize=False), 0)
    assert measures["position_rmse_m"] < 0.1
    assert measures["heading_rmse_deg"] < 4.0
    assert measures["lost_share"] < 0.05


@pytest.mark.parametrize(
    ("pose", "changes", "complaint"),
    [
        (Pose2D(50.0, 0.0, 0.0), {}, r"outside the map, which covers \("),
        (Pose2D(math.nan, 0.0, 0.0), {}, "must be finite"),
        (START, {"covariance": np.eye(2)}, "covariance must be"),
        (START, {"covariance": np.diag([1.0, -1.0, 1.0])}, "covariance must be"),
        (None, {"grid": None}, "needs a map"),
        (None, {"grid": OccupancyGrid(np.full((10, 10), 100, dtype=np.int8), 0.05, (0.0, 0.0))}, "no free cell"),
    ],
)
def test_starts_that_cannot_be_are_refused(pose, changes, complaint):
    with pytest.raises(ValueError, match=complaint):
        started(0, pose, **changes)


@pytest.mark.parametrize("value", [-1, 100])
def test_a_robot_that_starts_in_an_obstacle_of_the_map_is_tracked(caplog, value):
    def cover(data, row, col):
        data[row - 6 : row + 7, col - 6 : col + 7] = value

    amcl = started(grid=changed_map(cover), covariance=None)
    assert "lies on a cell of the map that is not free" in caplog.text
    for _ in range(12):
        amcl.update(see(START), Pose2D(0.0, 0.0, 0.0))
    assert not amcl.belief.is_lost
    assert distance(amcl, START) < 0.1


def test_bad_input():
    still = Pose2D(0.0, 0.0, 0.0)
    with pytest.raises(RuntimeError, match="call reset first"):
        Amcl(LIDAR, PARAMS).update(see(START), still)
    with pytest.raises(ValueError, match="180"):
        started().update(Reading.of_scan(np.ones(3, dtype=np.float32)), still)
    with pytest.raises(ValueError, match="finite"):
        started().update(see(START), Pose2D(math.inf, 0.0, 0.0))


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"max_particles": 10}, "max_particles must be at least min_particles, got 10"),
        ({"sensor": "sonar"}, r"sensor\n.*'likelihood_field', 'likelihood_field_prob' or 'beam'"),
        ({"alpha3": math.nan}, r"alpha3\n.*finite"),
        ({"alpha_slow": 0.2, "alpha_fast": 0.1}, "alpha_slow must not exceed alpha_fast"),
    ],
)
def test_params_refuse_nonsense(change, complaint):
    with pytest.raises(ValueError, match=complaint):
        AmclParams(**change)


def test_unknown_presets_are_named():
    with pytest.raises(ValueError, match=r"unknown AMCL preset 'ros'.*nav2"):
        load_preset("ros")
