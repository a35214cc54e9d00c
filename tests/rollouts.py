"""Episodes and worlds for tests."""

import numpy as np

from envs.geometry import Pose2D
from envs.navigation.candidates import COST, FAILURES
from tests.rooms import make_room


def rollout(env, seed, steps):
    """Drive with fixed pseudo-random actions; return everything that comes out."""
    rng = np.random.default_rng(seed)
    out = [env.reset(seed=seed)]
    for _ in range(steps):
        out.append(env.step(rng.uniform(-1, 1, 2).astype(np.float32)))
        if out[-1][2] or out[-1][3]:
            break
    return out


def nearest(observation):
    """Return the candidate with the cheapest path, as an action; those that failed come last."""
    features, mask = observation["candidates"], observation["action_mask"] == 1
    return np.int64(np.where(mask, features[:, COST] + 10.0 * (features[:, FAILURES] > 0), np.inf).argmin())


def hall(width=8.0, height=4.0, segments=()):
    """Return a rectangular world with its lower left corner at the origin, and further walls in it."""
    return make_room(0.0, 0.0, width, height, segments, spawn=Pose2D(0.4, 0.4, 0.0))
