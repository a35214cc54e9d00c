import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from scipy import ndimage

from lidarnaut.benchmarks.speed import __main__ as command
from lidarnaut.benchmarks.speed import measuring, parts
from lidarnaut.benchmarks.speed.designs import Design, benchmark_robot, make_actions
from lidarnaut.benchmarks.speed.halls import GAP, make_hall
from lidarnaut.benchmarks.speed.kernels import make_kernels
from lidarnaut.benchmarks.speed.naive import NaiveExploreEnv, NaivePhysics
from lidarnaut.benchmarks.speed.naive_slam import NaiveSlam
from lidarnaut.benchmarks.speed.peers import compare as peers
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.estimation.motion import WheelMotion
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.clearance import clearance
from lidarnaut.envs.geometry.raycast import cast_rays
from lidarnaut.envs.simulation import Twist, make_simulator
from lidarnaut.envs.slam import load_params, make_slam
from lidarnaut.envs.slam.grid_map import MAX_COUNT, probabilities
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.worlds import rasterize
from lidarnaut.envs.worlds.world import box, edges


@pytest.fixture(scope="module")
def hall():
    return make_hall(50)


@pytest.mark.parametrize("num_bodies", [50, 300])
def test_a_hall_is_closed_passable_and_the_same_each_time(num_bodies):
    hall = make_hall(num_bodies)
    crates, walls = hall.boxes[:-4], hall.boxes[-4:]
    assert len(crates) + len(hall.world.circles) == num_bodies
    np.testing.assert_array_equal(hall.world.segments, make_hall.__wrapped__(num_bodies).world.segments)
    # The world's segments are the outlines of the boxes, and the inner faces of the walls.
    np.testing.assert_array_equal(hall.world.segments[4:], np.vstack([edges(box(*crate)) for crate in crates]))
    assert np.abs(hall.world.segments[:4]).min() == min(abs(x + y) - 0.1 for x, y, *_ in walls)
    # Every collision-free position outside of crates and pillars is reachable.
    raster = rasterize(hall.world, 0.05)
    distances = ndimage.distance_transform_edt(raster.data == 0) * 0.05
    pieces, _ = ndimage.label(distances > benchmark_robot().radius)
    cells = np.argwhere(pieces > 0)
    points = raster.centers(cells)
    solid = np.zeros(len(points), dtype=bool)
    for x, y, length, width, yaw in crates:
        solid |= (np.abs(Pose2D(x, y, yaw).inverse().transform(points)) < (0.5 * length, 0.5 * width)).all(axis=1)
    for x, y, radius in hall.world.circles:
        solid |= np.hypot(*(points - (x, y)).T) < radius
    assert len(np.unique(pieces[tuple(cells[~solid].T)])) == 1
    assert np.count_nonzero(~solid) * 0.05**2 > 100.0
    assert clearance(0.0, 0.0, hall.world.segments, hall.world.circles) > GAP


@pytest.mark.parametrize("uses_truth", [False, True])
def test_naive_slam_is_the_same_slam(hall, uses_truth):
    """Equal scans, motions and random draws."""
    robot = benchmark_robot()
    simulator, odometry = make_simulator("kinematic", robot, 0.1), WheelMotion(robot)
    naive = NaiveSlam(robot.lidar, load_params("default"), match_scans=not uses_truth)
    own = make_slam("truth" if uses_truth else "tinyslam", robot.lidar)
    for slam in (naive, own):
        slam.reset(np.random.default_rng(1))
    [reading] = simulator.reset(hall.world, [Pose2D(0.0, 0.0, 0.0)], [np.random.default_rng(0)])
    motion = Pose2D(0.0, 0.0, 0.0)
    odometry.reset(reading)
    actions = make_actions(1)
    for _ in range(80):
        new = naive.update(reading.ranges, motion)
        belief = own.update(reading, motion)
        assert {tuple(cell) for cell in new.tolist()} == {tuple(cell) for cell in belief.update.new_cells.tolist()}
        truth = simulator.states[0].pose
        v, w = next(actions)[0].tolist()
        [reading] = simulator.step([Twist(v * robot.max_v, w * robot.max_w)])
        motion = odometry.update(reading)
        if uses_truth:
            motion = truth.between(simulator.states[0].pose)
    np.testing.assert_allclose(naive.pose, own.belief.pose, atol=1e-9)
    assert math.dist(naive.pose[:2], truth[:2]) < (1e-9 if uses_truth else 0.05)
    words = own.map.words
    np.testing.assert_array_equal(naive.counts, words & MAX_COUNT)
    np.testing.assert_allclose(naive.values, probabilities(words), atol=1e-4)
    assert naive.num_integrated > 10


def test_naive_lidar_sees_what_cast_rays_sees(hall):
    robot = benchmark_robot()
    robot = replace(robot, lidar=replace(robot.lidar, noise_std=0.0, resolution=0.0))
    lidar, pose = robot.lidar, Pose2D(0.2, -0.3, 0.4)
    physics = NaivePhysics(hall, robot, 0.1)
    seen = physics.scan(pose, np.random.default_rng(0))
    physics.close()
    sensor, ranges = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, 0.0)), np.empty(360)
    cast_rays(*sensor, lidar.beams, hall.world.segments, hall.world.circles, ranges)
    assert np.mean(np.abs(np.nan_to_num(seen - ranges, posinf=9.0)) < 0.003) > 0.98  # except grazing beams


@pytest.mark.filterwarnings("ignore:.*Step info are not equal")  # PyBullet keeps traces of contacts after a reset
def test_naive_environment_does_the_job_of_ours(hall):
    """Same world, robot and actions: PyBullet at 240 Hz and our kinematics give similar drives and maps."""
    naive = NaiveExploreEnv(hall, benchmark_robot())
    own = LidarEnv(Explore, world=hall.world, robot=benchmark_robot(), physics="kinematic", start="spawn")
    check_env(naive, skip_render_check=True)
    for env in (naive, own):
        env.reset(seed=0)
    assert naive.time_limit == own.time_limit
    actions, total = make_actions(1), np.zeros(2)
    for _ in range(150):
        action = next(actions)[0]
        observations, rewards, *_, infos = zip(*(env.step(action) for env in (naive, own)))
        total += rewards
        assert all(info["pose_error"][0] < 0.05 for info in infos)
    assert infos[0]["explored_fraction"] == pytest.approx(infos[1]["explored_fraction"], abs=0.02)
    assert total[0] == pytest.approx(total[1], rel=0.1)
    assert 0.05 < np.mean(observations[0]["map"][1] > 0) <= 1.0
    naive.close()


def test_every_kernel_computes_what_its_reference_does():
    kernels = make_kernels(50)
    assert {"cast_rays", "match", "integrate_scan", "pool_map", "crop", "advance"} == {k.name for k in kernels}
    for kernel in kernels:
        kernel.function(*kernel.arguments)
        result, reference = kernel.read().astype(float), kernel.reference().astype(float)
        assert len(np.unique(result)) > 1
        np.testing.assert_allclose(result, reference, atol=1e-4, err_msg=kernel.name)


def test_a_run_measures_all_and_writes_what_is_documented(tmp_path, monkeypatch):
    designs = (Design("naive"), Design("kinematic"), Design("vector", 16, 2), Design("subproc", 2))
    monkeypatch.setattr(command, "DESIGNS", designs)
    monkeypatch.setattr(command, "BODIES", (50,))
    command.main(("designs", "kernels", "memory", "physics"), tmp_path / "speed.json", quick=True)
    written = json.loads((tmp_path / "speed.json").read_text())
    assert list(written) == ["machine", "designs", "kernels", "memory", "physics"]
    rows = written["designs"]
    assert [(row["name"], row["num_envs"], row["cores"]) for row in rows[:4]] == [tuple(d) for d in designs]
    for row in rows:
        naive = rows[4 * (row["slam"] == "truth")]
        assert row["ratio"] == pytest.approx(row["steps_per_second"] / naive["steps_per_second"])
        assert 5 < row["steps_per_second"] < 1e6
    assert rows[1]["ratio"] > 3  # the kinematic environment, independent of the load
    assert all(0 < row["us"] < row["NumPy us"] for row in written["kernels"])
    further = written["memory"][0]["MiB of a further sub-environment"]
    assert 0.8 < further < 4.0
    assert all(0 < row["least us"] <= row["median us"] for row in written["physics"])


def test_trainings_are_measured(monkeypatch):
    monkeypatch.setattr(measuring, "TRAININGS", ("rooms_fast",))
    rows = measuring.trainings({1: lambda function, *arguments: function(*arguments)}, 0.0, 1)
    measuring.open_cases([])
    assert [(row["training"], row["cores"]) for row in rows] == [("rooms_fast", 1)]
    assert 10 < rows[0]["steps/s"] < 1e6


def test_one_and_many_environments_decide(monkeypatch):
    monkeypatch.setattr(parts, "NUM_DECIDING", (1, 2))
    rows = parts.decisions(6)
    assert [row["sub-environments"] for row in rows] == [1, 2]
    assert all(row["decisions/s"] > 0 and row["steps/decision"] > 1 for row in rows)


def test_growth_is_drawn(tmp_path):
    keys = itertools.product(("beams", "num_envs"), ("tinyslam", "truth"), (90, 180))
    rows = [{"grows": key, "slam": slam, "at": at, "us": 0.3 * at} for key, slam, at in keys]
    command.plot_growth(rows, tmp_path / "growth.png")
    assert (tmp_path / "growth.png").read_bytes().startswith(b"\x89PNG")


FAKE = """
import json, sys
name, seconds, *cases = sys.argv[1:]
if name == "broken":
    sys.exit("no such module")
for case in cases:
    num_envs, people = map(int, case.split("x"))
    steps = {"ours": 300, "peer": 30 * num_envs, "odd": "many"}[name]
    print(json.dumps({"num_envs": num_envs, "people": people, "steps": steps, "seconds": float(seconds)}))
"""


def test_peers_become_rows_or_say_why_they_are_skipped(tmp_path, monkeypatch):
    monkeypatch.setattr(peers, "HOME", tmp_path)
    (tmp_path / "fake.py").write_text(FAKE)
    names = "ours", "peer", "odd", "broken", "missing"
    table = {name: {"simulates": f"world of {name}", "cases": ["1x0", "4x2"]} for name in names}
    (tmp_path / "missing" / "bin").mkdir(parents=True)
    for program in ("pip", "python"):
        (tmp_path / "missing" / "bin" / program).write_text("#!/bin/sh\necho 'no matching distribution' >&2\nexit 1\n")
        (tmp_path / "missing" / "bin" / program).chmod(0o700)
    table["missing"]["packages"] = ["missing==1.0", "torch=={torch}"]
    rows = peers.compare({**table, "named": {"skipped": "not in a registry"}}, 0.1, 2, tmp_path / "fake.py")
    measured = [[row[key] for key in ("simulator", "sub-environments", "people", "steps/s")] for row in rows[:4]]
    assert measured == [["ours", 1, 0, 3000], ["peer", 1, 0, 300], ["ours", 4, 2, 3000], ["peer", 4, 2, 1200]]
    assert [row["ratio"] for row in rows[:4]] == pytest.approx([1.0, 0.1, 1.0, 0.4])
    reasons = {row["simulator"]: row["simulates"] for row in rows[4:]}
    assert reasons.pop("odd").startswith('skipped: unreadable output \'{"num_envs": 1,')
    assert reasons == {
        "named": "skipped: not in a registry",
        "broken": "skipped: no such module",
        "missing": "skipped: no matching distribution",
    }
