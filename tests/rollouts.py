"""Episodes for tests."""

import numpy as np


def rollout(env, seed, steps):
    """Drive with fixed pseudo-random actions; return everything that comes out."""
    rng = np.random.default_rng(seed)
    out = [env.reset(seed=seed)]
    for _ in range(steps):
        out.append(env.step(rng.uniform(-1, 1, 2).astype(np.float32)))
        if out[-1][2] or out[-1][3]:
            break
    return out
