"""The example of domain randomization runs, on a small budget, and gives what its text says."""

import importlib.util
from pathlib import Path


def test_each_episode_has_wheels_of_its_own():
    path = Path(__file__).parents[2] / "examples" / "domain_randomization.py"
    spec = importlib.util.spec_from_file_location("domain_randomization", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    rows = module.main(episodes=2, seconds=5.0)
    low, high = module.RANGES["drive.wheel_radius"]
    assert low <= rows[:, 0].min() < rows[:, 0].max() <= high
    assert (rows[:, 1] < 0.5).all()
