import csv

import gymnasium
import numpy as np
import pytest

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import ORIGIN
from lidarnaut.envs.logs.replay import Options
from lidarnaut.envs.logs.replay import main as replay
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation import Reading
from lidarnaut.envs.slam import GMappingParams, GraphSlamParams, HectorParams, load_params, make_slam
from lidarnaut.envs.tasks.explore import Explore, ExploreTeam
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from lidarnaut.envs.tasks.track import Track
from lidarnaut.evaluate_command import main as evaluate
from tests.test_contract import TASKS

LIDAR = load_robot("turtlebot3_burger").lidar


def test_a_preset_and_single_parameters_follow_the_name():
    params = make_slam("tinyslam?preset=robot_vacuum,sigma_xy=0.02", LIDAR).params
    assert (params.sigma_xy, params.sigma_theta, params.max_tries) == (0.02, 0.02, 100)
    assert make_slam("hector?preset=faithful", LIDAR).params.uses_odometry is False
    for slam, params in (("hector", HectorParams), ("graph", GraphSlamParams), ("gmapping", GMappingParams)):
        assert load_params("default", slam=slam) == params()
    assert load_params("intel", {"loops": {"min_score": "0.6"}}, "graph").loops.min_score == 0.6


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hectare", r"unknown SLAM 'hectare'.*tinyslam, hector, graph, gmapping, odometry, truth"),
        ("hektor?preset=faithful", "did you mean 'hector'"),
        ("hector?preset=fathful", r"preset of hector 'fathful'.*did you mean 'faithful'.*default, faithful, intel"),
        ("hector?sigma=3", "unknown key 'sigma'"),
        ("tinyslam?sigma_xy=-1", "sigma_xy"),
        ("hector?resolution=0.1", "map_resolution"),
        ("hector?preset", r"NAME\?KEY=VALUE"),
        ("hector?", r"NAME\?KEY=VALUE"),
        ("hector?num_levels=[", "num_levels is not valid"),
        ("tinyslam?preset=", "preset of tinyslam must be a name"),
        ("tinyslam?preset=3", "preset of tinyslam must be a name"),
        ("tinyslam?sigma_xy=0.1,sigma_xy=0.2", "sigma_xy is given twice"),
        ("tests.slam.rooms:make_small?sigma_xy=0.1", "only SLAMs of this package take parameters"),
    ],
)
def test_a_mistake_is_named(name, message):
    with pytest.raises(ValueError, match=message):
        make_slam(name, LIDAR)


ROOM = "turtlebot3_world"
SPEC = "hector?preset=faithful,num_levels=2"


@pytest.mark.parametrize("slam", ["odometry", "tinyslam", "hector", "graph", "gmapping"])
def test_readings_beyond_the_maximum_range_are_no_walls(slam):
    near, far = (make_slam(f"{slam}?max_range={limit}", LIDAR) for limit in (2.0, 9.0))
    ranges = np.full(LIDAR.num_beams, 3.0, dtype=np.float32)
    ranges[:90] = 1.0
    grids = [one.update(Reading.of_scan(ranges), ORIGIN).grid for one in (near, far)]
    centers = [grid.centers(np.argwhere(grid.data > 50)) for grid in grids]
    assert np.hypot(*(centers[0] - (LIDAR.mount.x, 0.0)).T).max() < 1.1
    assert np.hypot(*(centers[1] - (LIDAR.mount.x, 0.0)).T).max() > 2.9
    free = grids[0].centers(np.argwhere(grids[0].data == grids[0].data[grids[0].data >= 0].min()))
    assert 1.8 < np.hypot(*(free - (LIDAR.mount.x, 0.0)).T).max() < 2.1


def test_a_maximum_range_below_the_minimum_of_the_lidar_is_refused():
    with pytest.raises(ValueError, match=r"max_range must exceed the lidar's range_min 0.6, got 0.5"):
        make_slam("hector?max_range=0.5", load_robot("tugbot").lidar)


def test_every_task_takes_parameters():
    for task, slam in ((ReachGoal, SPEC), (Explore, SPEC), (ExploreTeam, "hector?num_levels=2")):
        env = LidarEnv(task, world=ROOM, slam=slam, physics="kinematic")
        env.reset(seed=0)
        assert {robot.estimator.params.num_levels for robot in env.robots} == {2}
    env = gymnasium.make("lidarnaut/Explore-v0", slam="truth?min_travel_distance=0.5", world=ROOM).unwrapped
    env.reset(seed=0)
    assert env.robots[0].estimator.params.min_travel_distance == 0.5
    assert env.task.uses_true_motion
    maps = []
    for slam in ("tinyslam", "tinyslam?max_range=1.0"):
        env = LidarEnv(Track, **TASKS["Track"] | {"slam": slam})
        env.reset(seed=0)
        maps.append(np.count_nonzero(env.belief.grid.data >= 0))
    assert maps[1] < 0.8 * maps[0]


def test_evaluations_take_parameters_and_resume(tmp_path, no_overview):
    slams = ["--slam", SPEC, "graph?preset=cartographer"]
    options = ["--policies", "random", "--worlds", ROOM, *slams, "--episodes", "1", "--time-limit", "3"]
    for _ in range(2):
        assert evaluate([*options, "--physics", "kinematic", "--out", str(tmp_path)]) == 0
    with (tmp_path / "episodes.csv").open() as file:
        assert [row["slam"] for row in csv.DictReader(file)] == [SPEC, "graph?preset=cartographer"]
    assert len(list((tmp_path / "episodes").glob("random__*.npz"))) == 2
    assert SPEC in (tmp_path / "report.html").read_text()


def test_replays_take_parameters(tmp_path):
    log = tmp_path / "drive.log"
    log.write_text("FLASER 3 1.0 1.5 2.0 0 0 0 0 0 0 1.0 host 1.0\nFLASER 3 1.0 1.5 2.0 0.3 0 0 0.3 0 0 2.0 host 2.0\n")
    (run,) = replay(Options(log, slam=SPEC, out=tmp_path / "out"))
    assert run.slam == SPEC
    assert (tmp_path / "out").is_dir()
