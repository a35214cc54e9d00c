import hashlib

import gymnasium
import numpy as np
import pytest

from tests.robustness.conftest import in_new_process

CASES = {
    **{f"Explore-v0, {slam}": ("Explore", {"slam": slam}) for slam in ("tinyslam", "hector", "gmapping", "graph")},
    "Explore-v0, bullet": ("Explore", {"physics": "bullet"}),
    "ExploreFrontiers-v0": ("ExploreFrontiers", {}),
    "ExploreTeam-v0": ("ExploreTeam", {"num_robots": 2}),
    "Navigate-v0": ("Navigate", {}),
}
COMMON = {"world": "rooms", "world_size": (8.0, 8.0), "physics": "kinematic", "control_hz": 5.0}
ELSEWHERE = {
    "another process": {},
    "one thread": {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
    "four threads": {"OMP_NUM_THREADS": "4", "NUMBA_NUM_THREADS": "4"},
    "another hash seed": {"PYTHONHASHSEED": "77"},
}


def digest(case):
    id, arguments = CASES[case]
    env = gymnasium.make(f"lidarnaut:lidarnaut/{id}-v0", **COMMON | arguments).unwrapped
    found = hashlib.sha256()
    observation, info = env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(100):
        for name in sorted(observation):
            found.update(observation[name].tobytes())
        found.update(repr((info["time"], np.asarray(info["pose_error"]).tolist(), info["rewards"])).encode())
        observation, _, terminated, truncated, info = env.step(env.action_space.sample())
        if terminated or truncated:
            break
    env.close()
    return found.hexdigest()


def digests():
    return {case: digest(case) for case in CASES}


@pytest.mark.slow
def test_episodes_repeat_elsewhere_to_the_last_byte(row):
    wanted = digests()
    for name, variables in ELSEWHERE.items():
        assert in_new_process(digests, **variables) == wanted, name
        row("the same seed", where=name, episodes=len(CASES), other_bytes=0)
