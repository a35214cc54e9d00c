"""Vector environments of the package, and Gymnasium's `SyncVectorEnv` of equal single environments."""

import contextlib

import gymnasium
from gymnasium.vector import SyncVectorEnv

from lidarnaut.envs.vector import make_vec


@contextlib.contextmanager
def both(id, mode, num_workers, arguments, wrappers=(), num_envs=3):
    """Yield the two environments, and close them."""

    def single():
        env = gymnasium.make(id, disable_env_checker=True, **arguments)
        for wrapper in wrappers:
            env = wrapper(env)
        return env

    how = {"wrappers": wrappers, "num_workers": num_workers, "autoreset_mode": mode}
    ours = make_vec(id, num_envs, **how, **arguments)
    theirs = SyncVectorEnv([single] * num_envs, autoreset_mode=mode)
    with contextlib.closing(ours), contextlib.closing(theirs):
        yield ours, theirs
