import copy
import json
import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecMonitor, VecNormalize

from lidarnaut.agents.infos import TRUNCATED, info_of, lazy_infos
from lidarnaut.agents.vec_env import GymnasiumVecEnv

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
            assert isinstance(own, dict)
            assert own.get("progress") == info.get("progress")
            assert ("map_iou" in own) == ("map_iou" in info)
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


VALUES = {"time": 0.5, "is_success": True, "hits": 3, "rewards": {"a": 1.0, "b": 2.0}, "pair": np.arange(2)}


def lazy():
    """Return the second of two infos; the first one lacks all entries but `time`."""
    mask, both = np.array([False, True]), np.array([True, True])
    info = {"time": np.array([0.25, 0.5]), "is_success": np.array([False, True]), "hits": np.array([0, 3])}
    info |= {"pair": np.arange(4).reshape(2, 2) - 2, "final_info": {"x": np.zeros(2), "_x": mask}}
    info |= {f"_{name}": mask for name in info} | {"_time": both, "_rewards": mask}
    info["rewards"] = {"a": np.array([0.0, 1.0]), "_a": mask, "b": np.array([0.0, 2.0]), "_b": mask}
    del info["_final_info"]
    first, second = lazy_infos(info, 2)
    assert {**first} == {TRUNCATED: False, "time": 0.25}
    np.testing.assert_equal(info_of(info, 1), VALUES)
    return second


READ = {
    "item": lambda info: info["time"],
    "nested": lambda info: info["rewards"],
    "get": lambda info: (info.get("hits"), info.get("none"), info.get("none", 4), info.get(TRUNCATED)),
    "in": lambda info: ("time" in info, "none" in info, TRUNCATED in info),
    "len": len,
    "truth": bool,
    "list": lambda info: sorted(info),
    "reversed": lambda info: sorted(reversed(info)),
    "keys": lambda info: sorted(info.keys()),
    "values": lambda info: sum(value for value in info.values() if isinstance(value, float)),
    "items": lambda info: sorted(info.items(), key=lambda item: item[0]),
    "dict": dict,
    "unpacked": lambda info: {**info},
    "arguments": lambda info: (lambda **named: named)(**{"a": 1}, **info),
    "copy": lambda info: info.copy(),
    "copied": copy.copy,
    "deep copy": copy.deepcopy,
    "pickle": lambda info: pickle.loads(pickle.dumps(info)),
    "or": lambda info: info | {"x": 1},
    "ror": lambda info: {"x": 1, "time": 2} | info,
    "ior": lambda info: info.__ior__({"x": 1}),
    "update": lambda info: (info.update(x=1), dict(info))[1],
    "set": lambda info: (info.__setitem__("time", 7), dict(info))[1],
    "delete": lambda info: (info.__delitem__("time"), dict(info))[1],
    "pop": lambda info: (info.pop("hits"), "hits" in info, len(info)),
    "setdefault": lambda info: (info.setdefault("hits", 9), info.setdefault("x", 9), len(info)),
    "clear": lambda info: (info.clear(), len(info), "time" in info, info.get("time")),
    "json": lambda info: json.loads(json.dumps(info, default=np.ndarray.tolist)),
    "repr": lambda info: eval(repr(info), {"array": np.array}),
}


@pytest.mark.parametrize("name", READ)
def test_lazy_infos_are_read_and_changed_as_dictionaries(name):
    found, expected = READ[name](lazy()), READ[name]({TRUNCATED: False, **VALUES})
    np.testing.assert_equal(found, expected)


def test_lazy_infos_are_equal_to_dictionaries():
    with pytest.raises(KeyError, match="none"):
        lazy()["none"]
    plain = {name: value for name, value in VALUES.items() if name != "pair"} | {TRUNCATED: False}
    own = lazy()
    del own["pair"]
    assert own == plain
    assert plain == own
    assert lazy() != plain
