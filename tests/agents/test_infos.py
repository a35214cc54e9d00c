import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecMonitor, VecNormalize

from lidarnaut.agents.vec_env import GymnasiumVecEnv, infos_of

ENVS = {
    "ReachGoal": {"observations": ("motion",), "people": 2},
    "Explore": {"observations": ("motion",)},
    "ExploreTeam": {"observations": ("motion",)},
}


def pair(id, kind, num_envs=2, **arguments):
    """Return `DummyVecEnv` and `GymnasiumVecEnv` of equal environments."""
    arguments = {"time_limit": 1.0, "physics": "kinematic", **ENVS[id], **arguments}
    dummy = DummyVecEnv([lambda: gymnasium.make(f"lidarnaut/{id}-v0", **arguments)] * num_envs)
    own = {"autoreset_mode": AutoresetMode.SAME_STEP}
    own = {**own, "num_workers": 0, **arguments} if kind == "native" else {"vector_kwargs": own, **arguments}
    names = {"native": "vector_entry_point"}
    vector = gymnasium.make_vec(f"lidarnaut/{id}-v0", num_envs, names.get(kind, kind), **own)
    return dummy, GymnasiumVecEnv(vector)


@pytest.mark.parametrize(("id", "kind"), [*((id, "native") for id in ENVS), ("ReachGoal", "sync")])
def test_infos_hold_what_those_of_dummy_vec_env_hold(id, kind):
    envs, ended = pair(id, kind), 0
    for env in envs:
        env.seed(0)
        env.reset()
    np.testing.assert_equal(*(env.reset_infos for env in envs))
    for k in range(22):
        actions = np.full((2, *envs[0].action_space.shape), 0.1 * (k % 5), dtype=np.float32)
        (*_, dones, theirs), (*_, ours) = (env.step(actions) for env in envs)
        for info, own, done in zip(theirs, ours, dones, strict=True):
            ended += done
            own = {key: value for key, value in own.items() if key != "episode" or not done}
            assert {name: type(value) for name, value in own.items()} == {name: type(info[name]) for name in info}
            np.testing.assert_equal(own, info)
        np.testing.assert_equal(*(env.reset_infos for env in envs))
    assert ended >= 4


def test_wrappers_of_stable_baselines3_find_all_entries(tmp_path):
    keys = ("progress", "collisions", "end_reason", "rewards")
    episodes = []
    for env in pair("ReachGoal", "native"):
        env = VecMonitor(VecFrameStack(VecNormalize(env), 2), str(tmp_path / "log"), info_keywords=keys)
        env.seed(0)
        env.reset()
        ended = []
        for _ in range(11):
            *_, infos = env.step(np.zeros((2, 2), dtype=np.float32))
            ended += [info for info in infos if "episode" in info]
        episodes.append([{key: info["episode"][key] for key in (*keys, "r", "l")} for info in ended])
        assert len(ended) == 2
        assert all(info["terminal_observation"].keys() == env.observation_space.spaces.keys() for info in ended)
        assert all(env.observation_space.contains(info["terminal_observation"]) for info in ended)
    assert episodes[0] == episodes[1]


def test_infos_have_the_entries_that_masks_select_as_numbers_of_python():
    mask, both = np.array([False, True]), np.array([True, True])
    info = {"time": np.array([0.25, 0.5]), "is_success": np.array([False, True]), "hits": np.array([0, 3])}
    info |= {"pair": np.arange(4).reshape(2, 2) - 2, "final_info": {"x": np.zeros(2), "_x": mask}}
    info |= {f"_{name}": mask for name in info} | {"_time": both, "_rewards": mask}
    info["rewards"] = {"a": np.array([0.0, 1.0]), "_a": mask, "b": np.array([0.0, 2.0]), "_b": mask}
    info |= {"words": np.array([None, "wall"]), "_words": mask, "weights": np.ones(2, np.float32), "_weights": mask}
    first, second = infos_of(info, 2)
    assert first == {"time": 0.25}
    values = {"time": 0.5, "is_success": True, "hits": 3, "rewards": {"a": 1.0, "b": 2.0}, "pair": np.arange(2)}
    values |= {"words": "wall", "weights": np.float32(1.0)}
    np.testing.assert_equal(second, values)
    assert {name: type(value) for name, value in second.items()} == {name: type(one) for name, one in values.items()}
