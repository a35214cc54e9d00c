import csv
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import lidarnaut
from lidarnaut.agents.config import TrainingConfig
from lidarnaut.agents.training import train
from lidarnaut.benchmarks.drives.slams import compare_slams
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.files import parse_record
from lidarnaut.envs.geometry import ORIGIN
from lidarnaut.envs.logs.replay import Options
from lidarnaut.envs.logs.replay import main as replay
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation import Reading
from lidarnaut.envs.slam import make_slam
from lidarnaut.envs.tasks.explore import Explore, ExploreTeam
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from lidarnaut.envs.tasks.track import Track
from lidarnaut.evaluate_command import main as evaluate
from tests.test_contract import TASKS

LIDAR = load_robot("turtlebot3_burger").lidar


def test_a_preset_and_single_parameters_follow_the_name() -> None:
    params = make_slam("tinyslam?preset=robot_vacuum,sigma_xy=0.02", LIDAR).params  # type: ignore[attr-defined]
    assert (params.sigma_xy, params.sigma_theta, params.max_tries) == (0.02, 0.02, 100)
    assert make_slam("hector?preset=faithful", LIDAR).params.uses_odometry is False  # type: ignore[attr-defined]


def test_environments_take_parameters() -> None:
    env = gymnasium.make("lidarnaut/Explore-v0", slam="truth?min_travel_distance=0.5", world="turtlebot3_world")
    env.reset(seed=0)
    assert env.unwrapped.robots[0].estimator.params.min_travel_distance == 0.5  # type: ignore[attr-defined]
    assert env.unwrapped.task.uses_true_motion  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hector?preset=fathful", "did you mean 'faithful'"),
        ("hector?sigma=3", "unknown key 'sigma'"),
        ("tinyslam?sigma_xy=-1", "sigma_xy"),
        ("hector?resolution=0.1", "map_resolution"),
        ("hector?preset", "NAME\\?KEY=VALUE"),
        ("hector?num_levels=[", "num_levels is not valid"),
        ("hektor?preset=faithful", "did you mean 'hector'"),
    ],
)
def test_a_mistake_is_named(name: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_slam(name, LIDAR)


ROOM = "turtlebot3_world"
SPEC = "hector?preset=faithful,num_levels=2"


@pytest.mark.parametrize("slam", ["odometry", "tinyslam", "hector", "graph", "gmapping"])
def test_readings_beyond_the_maximum_range_are_no_walls(slam: str) -> None:
    near, far = (make_slam(f"{slam}?max_range={limit}", LIDAR) for limit in (2.0, 9.0))
    ranges = np.full(LIDAR.num_beams, 3.0, dtype=np.float32)
    ranges[:90] = 1.0
    grids = [one.update(Reading.of_scan(ranges), ORIGIN).grid for one in (near, far)]
    centers = [grid.centers(np.argwhere(grid.data > 50)) for grid in grids]
    assert np.hypot(*(centers[0] - (LIDAR.mount.x, 0.0)).T).max() < 1.1
    assert np.hypot(*(centers[1] - (LIDAR.mount.x, 0.0)).T).max() > 2.9
    free = grids[0].centers(np.argwhere(grids[0].data == grids[0].data[grids[0].data >= 0].min()))
    assert 1.8 < np.hypot(*(free - (LIDAR.mount.x, 0.0)).T).max() < 2.1


def test_a_maximum_range_below_the_minimum_of_the_lidar_is_refused() -> None:
    with pytest.raises(ValueError, match=r"max_range must exceed the lidar's range_min 0.6, got 0.5"):
        make_slam("hector?max_range=0.5", load_robot("tugbot").lidar)


def test_every_task_takes_parameters() -> None:
    for task, slam in ((ReachGoal, SPEC), (Explore, SPEC), (ExploreTeam, SPEC.replace("faithful", "default"))):
        robots: dict[str, Any] = {"num_robots": 2} if task is ExploreTeam else {}
        env = LidarEnv(task, world=ROOM, slam=slam, physics="kinematic", **robots)
        env.reset(seed=0)
        assert [robot.estimator.params.num_levels for robot in env.robots] == [2] * max(1, len(env.robots))  # type: ignore[attr-defined]
    maps = []
    for slam in ("tinyslam", "tinyslam?max_range=1.0"):
        env = LidarEnv(Track, **TASKS["Track"] | {"slam": slam})
        env.reset(seed=0)
        maps.append(np.count_nonzero(env.belief.grid.data >= 0))
    assert maps[1] < 0.8 * maps[0]


def test_registered_environments_take_parameters() -> None:
    lidarnaut.register("tests/Faithful-v0", Explore, world=ROOM, slam=SPEC, physics="kinematic")
    env = gymnasium.make("tests/Faithful-v0")
    env.reset(seed=0)
    assert env.unwrapped.robots[0].estimator.params.uses_odometry is False  # type: ignore[attr-defined]


def test_evaluations_take_parameters_and_resume(tmp_path: Path, no_overview: None) -> None:
    slams = ["--slam", SPEC, "graph?preset=cartographer"]
    options = ["--policies", "random", "--worlds", ROOM, *slams, "--episodes", "1", "--time-limit", "3"]
    for _ in range(2):
        assert evaluate([*options, "--physics", "kinematic", "--out", str(tmp_path)]) == 0
    with (tmp_path / "episodes.csv").open() as file:
        assert [row["slam"] for row in csv.DictReader(file)] == [SPEC, "graph?preset=cartographer"]
    assert len(list((tmp_path / "episodes").glob("random__*.npz"))) == 2
    assert SPEC in (tmp_path / "report.html").read_text()


def test_drives_and_replays_take_parameters(tmp_path: Path) -> None:
    rows = compare_slams((SPEC, "tinyslam"), ("turtlebot3_world:turtlebot3_burger",), seeds=1, minutes=0.1)
    assert [row["slam"] for row in rows] == [SPEC, "tinyslam"]
    log = tmp_path / "drive.log"
    log.write_text("FLASER 3 1.0 1.5 2.0 0 0 0 0 0 0 1.0 host 1.0\nFLASER 3 1.0 1.5 2.0 0.3 0 0 0.3 0 0 2.0 host 2.0\n")
    (run,) = replay(Options(log, slam=SPEC, out=tmp_path / "out"))
    assert run.slam == SPEC
    assert (tmp_path / "out").is_dir()


def test_trainings_take_parameters(tmp_path: Path, no_curves: None, no_workers: None) -> None:
    environment = {"world": ROOM, "physics": "kinematic", "slam": SPEC, "control_hz": 5, "time_limit": 5}
    hyperparameters = {"n_steps": 16, "batch_size": 32, "n_epochs": 1}
    data = {"experiment": "spec", "algorithm": "PPO", "total_steps": 32, "num_envs": 2, "environment": environment}
    data |= {"evaluation": {"episodes": 1, "references": []}}
    config = parse_record({**data, "hyperparameters": hyperparameters}, "spec", TrainingConfig)
    run = train(config, run=tmp_path / "run", progress=False)
    assert f"slam: {SPEC}" in (run / "config.yaml").read_text()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hector?", "NAME\\?KEY=VALUE"),
        ("tinyslam?preset=", "preset of tinyslam must be a name"),
        ("tinyslam?preset=3", "preset of tinyslam must be a name"),
        ("tinyslam?sigma_xy=0.1,sigma_xy=0.2", "sigma_xy is given twice"),
        ("tests.slam.rooms:make_small?sigma_xy=0.1", "only SLAMs of this package take parameters"),
    ],
)
def test_parameters_that_would_have_no_effect_are_refused(name: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_slam(name, LIDAR)
