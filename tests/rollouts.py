import numpy as np
from gymnasium.utils.env_checker import data_equivalence

from lidarnaut.baselines import policies_for
from lidarnaut.baselines.episode import run_episode
from lidarnaut.envs.navigation.frontiers.candidates import COST, FAILURES


def rollout(env, seed, steps, rule=None):
    """Act by a rule of observations, or by fixed pseudo-random twists; return all outputs."""
    rng = np.random.default_rng(seed)
    out = [env.reset(seed=seed)]
    for _ in range(steps):
        out.append(env.step(rule(out[-1][0]) if rule else rng.uniform(-1, 1, 2).astype(np.float32)))
        if out[-1][2] or out[-1][3]:
            break
    return out


def play(env, policy):
    """Return the episode of seed 0 of a classic policy, by name."""
    env.reset(seed=0)
    return run_episode(env, policies_for(env)[policy](), 0)


def nearest(observation):
    """Return the action of the cheapest path; failed candidates come last."""
    features, mask = observation["candidates"], observation["action_mask"] == 1
    return np.int64(np.where(mask, features[:, COST] + 10.0 * (features[:, FAILURES] > 0), np.inf).argmin())


def assert_same(ours, theirs):
    """Compare observation or info dicts of Gymnasium by sub-environment, only values with a set mask."""
    if isinstance(theirs, np.ndarray):  # an observation that is no dict
        np.testing.assert_array_equal(ours, theirs)
        return
    for key, value in theirs.items():
        if key.startswith("_"):
            np.testing.assert_array_equal(ours[key], value)
        elif isinstance(value, dict):
            assert_same(ours[key], value)
        elif key == "final_obs":
            for i in np.flatnonzero(theirs["_final_obs"]):
                assert_same(ours[key][i], value[i])
        else:
            mask = theirs.get(f"_{key}", np.ones(len(value), dtype=bool))
            np.testing.assert_array_equal(np.asarray(ours[key])[mask], np.asarray(value)[mask], err_msg=key)


def step_both(ours, theirs, actions, seed=5):
    """Reset and step two vector environments, assert equal outputs, and yield each step's outcome and info."""
    for ours_out, theirs_out in zip(ours.reset(seed=seed), theirs.reset(seed=seed), strict=True):
        assert_same(ours_out, theirs_out)
    for action in actions:
        observation, *outcome, info = ours.step(action)
        expected, *expected_outcome, expected_info = theirs.step(action)
        assert_same(observation, expected)
        assert_same(info, expected_info)
        for value, wanted in zip(outcome, expected_outcome, strict=True):
            np.testing.assert_array_equal(value, wanted)
            assert value.dtype == wanted.dtype
        yield outcome, info


def assert_same_info(ours, theirs):
    """Compare Gymnasium's info dicts: keys, masks, types and values, including values with an unset mask."""
    assert set(ours) == set(theirs)
    for key in theirs:
        if isinstance(theirs[key], dict):
            assert_same_info(ours[key], theirs[key])
            continue
        assert (ours[key].dtype, ours[key].shape) == (theirs[key].dtype, theirs[key].shape), key
        mine, wanted = ours[key], theirs[key]
        assert [type(one) for one in mine] == [type(one) for one in wanted], key
        if key == "final_obs":
            assert all(one is other or data_equivalence(one, other) for one, other in zip(mine, wanted, strict=True))
        else:
            np.testing.assert_equal(mine.tolist(), wanted.tolist(), err_msg=key)
