import gymnasium
import pytest

from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.slam import make_slam

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
