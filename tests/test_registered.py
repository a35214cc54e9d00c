"""What holds for every id."""

import warnings

import gymnasium
import pytest
from stable_baselines3.common.env_checker import check_env

import envs  # noqa: F401  (registers the environments)

IDS = [id for id in gymnasium.registry if id.startswith("lidarnaut/")]


@pytest.mark.parametrize("id", IDS)
def test_stable_baselines3_has_no_complaint(id):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # A remark on rows of candidates, robots and route points: they are for a network of one's own, as it says.
        warnings.filterwarnings("ignore", message="Your observation .* has an unconventional shape .*neither an image")
        env = gymnasium.make(id, physics="kinematic", disable_env_checker=True)
        check_env(env.unwrapped)
        env.close()
