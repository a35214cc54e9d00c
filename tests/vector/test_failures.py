import copy
import gc
import multiprocessing
import os
import pickle
import re
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.tasks.explore import Explore, ExploreTeam
from lidarnaut.envs.vector import LidarEnvs, LidarVectorEnv
from tests.rollouts import assert_same

QUICK = {"world": "rooms", "world_size": (6.0, 6.0), "control_hz": 5.0, "time_limit": 3.0, "physics": "kinematic"}
ACTIONS = np.full((3, 2), 0.5, dtype=np.float32)


class TwoArgumentsError(Exception):
    """Pickles, and does not unpickle."""

    def __init__(self, what, where):
        super().__init__(f"{what} in {where}")

    def __reduce__(self):
        return type(self), self.args


class TextError(Exception):
    def __reduce__(self):
        return str, ("no error at all",)


class Unloadable:
    def __reduce__(self):
        return int, ("no number",)


class Failing(LidarEnv):
    failure = None

    def fail(self, *_):
        failure, self.failure = self.failure, None
        if failure is not None:
            failure()

    speed = property(fail, fail)

    def commands(self, action):
        self.fail()
        return super().commands(action)

    def begin(self, **arguments):
        self.fail()
        super().begin(**arguments)

    def unloadable(self):
        return Unloadable()


def interrupt():
    raise KeyboardInterrupt


def interrupt_soon(delays=(0.3,)):
    """Send SIGINT to the main thread after delays."""
    for delay in delays:
        threading.Timer(delay, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT)).start()


raise_signal, fall_asleep = partial(signal.raise_signal, signal.SIGINT), partial(time.sleep, 8.0)
interrupt_twice = partial(interrupt_soon, (0.3, 0.6))
"""The first signal may have to wait for the end of a step."""


def two_arguments():
    raise TwoArgumentsError("nothing works", "a step")


def text_error():
    raise TextError("with a text")


@pytest.fixture
def env():
    others = set(multiprocessing.active_children())
    env = LidarVectorEnv(Failing, 3, task=Explore, num_workers=3, **QUICK)
    env.reset(seed=0)
    yield env
    began = time.monotonic()
    env.close()
    assert time.monotonic() - began < 5.0
    assert set(multiprocessing.active_children()) <= others


CALLS = {
    "step": lambda env: env.step(ACTIONS),
    "reset": lambda env: env.reset(seed=0),
    "call": lambda env: env.call("fail"),
    "get_attr": lambda env: env.get_attr("speed"),
    "set_attr": lambda env: env.set_attr("speed", 1.0),
}


HOWS = [interrupt, interrupt_soon, interrupt, interrupt_soon, interrupt]


@pytest.mark.parametrize(("call", "how"), [*zip(CALLS, HOWS), ("step", interrupt_twice)])
def test_after_an_interrupt_every_call_says_that_the_environment_must_be_closed(env, call, how):
    env.set_attr("failure", [how, None if how is interrupt else fall_asleep, None])
    with pytest.raises(KeyboardInterrupt):
        CALLS[call](env)
    for again in CALLS.values():
        with pytest.raises(RuntimeError, match=r"interrupted.*close it and make another"):
            again(env)


def test_a_step_comes_to_its_end_before_an_interrupt(env):
    times = [env.step(ACTIONS)[4]["time"][0] for _ in range(2)]
    for place in range(3):
        env.reset(seed=0)
        env.set_attr("failure", [raise_signal if i == place else None for i in range(3)])
        handler = signal.getsignal(signal.SIGINT)
        if place == 0:  # a worker ignores the signal
            with pytest.raises(KeyboardInterrupt):
                env.step(ACTIONS)
        else:
            env.step(ACTIONS)
        assert signal.getsignal(signal.SIGINT) is handler
        assert env.step(ACTIONS)[4]["time"].tolist() == [times[1]] * 3


@pytest.mark.parametrize(("failure", "text"), [(two_arguments, "nothing works in a step"), (text_error, "with a text")])
def test_errors_that_cannot_be_pickled_or_unpickled_are_shown_and_do_no_harm(env, failure, text):
    first, _ = env.reset(seed=0)
    env.set_attr("failure", [None, failure, None])
    with pytest.raises(RuntimeError, match=f"Error: {text}") as caught:
        env.step(ACTIONS)
    assert f"in {failure.__name__}" in caught.value.__notes__[0]
    env.set_attr("time_limit", [1.0, 2.0, 3.0])
    with pytest.raises((AttributeError, TypeError), match="pickle"):  # before any share is sent
        env.set_attr("time_limit", [4.0, 5.0, threading.Lock()])
    assert env.get_attr("time_limit") == (1.0, 2.0, 3.0)
    with pytest.raises(ValueError, match="no number"):
        env.call("unloadable")
    assert env.get_attr("time_limit") == (1.0, 2.0, 3.0)
    with pytest.raises(gymnasium.error.ResetNeeded, match="a step has failed"):
        env.step(ACTIONS)
    assert_same(env.reset(seed=0)[0], first)
    env.step(ACTIONS)


def test_ended_sub_environments_are_told_by_the_last_step():
    how = {"num_workers": 2, "autoreset_mode": "Disabled", "max_episode_steps": 1}
    env = LidarVectorEnv(Failing, 3, task=Explore, **how, **QUICK)
    env.reset(seed=0)
    assert env.step(ACTIONS)[3].all()
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"\[0, 1, 2\] have ended"):
        env.step(ACTIONS)
    env.reset(options={"reset_mask": np.array([True, False, True])})
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"\[1\] have ended"):
        env.step(ACTIONS)
    env.reset(options={"reset_mask": np.array([False, True, False])})
    env.step(ACTIONS)
    env.close()


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        ({"num_envs": 1.5}, "num_envs must be whole and from 1 to 100,000, got 1.5"),
        ({"num_envs": 10**7}, "num_envs must be whole and from 1 to 100,000"),
        ({"num_workers": -1}, "num_workers must be whole"),
        ({"max_episode_steps": 0}, "max_episode_steps must be whole"),
        ({"render_mode": "human"}, "render_mode"),
        ({"variants": []}, r"variants must be 1 to num_envs \(1\), got"),
        ({"num_envs": 2, "variants": [{}] * 3}, r"variants must be 1 to num_envs \(2\), got"),
    ],
)
def test_bad_arguments_are_named(arguments, culprit):
    with pytest.raises(ValueError, match=culprit):
        LidarEnvs(**{"num_envs": 1, "task": Explore, **QUICK, **arguments})


BAD_ACTIONS = [
    (Explore, np.zeros((1, 2)), "have shape"),
    (Explore, np.full((2, 2), np.nan), r"be finite.*sub-environment 0$"),
    (Explore, np.full((2, 2), 1.5), r"be finite.*sub-environment 0; clip_actions=True clips"),
    (ExploreTeam, np.full((2, 2, 2), 1.5), r"be finite(.|\n)*sub-environment 0; clip_actions=True clips"),
]


def test_bad_actions_are_refused():
    for task, actions, message in BAD_ACTIONS:
        env = LidarEnvs(2, task=task, num_workers=1, **QUICK)
        env.reset(seed=0)
        with pytest.raises(ValueError, match=f"actions must {message}"):
            env.step(actions)
        env.close()


def test_seeds_and_options_are_numbers_and_mappings():
    env = LidarEnvs(2, task=Explore, num_workers=0, **QUICK)
    for wrong in (1.5, True, [1], "ab", (1.5, 2.5), np.array(3)):
        says = re.escape(f"seed must be one whole number or 2 of them, got {wrong!r}")
        with pytest.raises(ValueError, match=says):
            env.reset(seed=wrong)
    for each in (env, LidarEnv(Explore, **QUICK)):
        with pytest.raises(ValueError, match="options must map names to values, got 5"):
            each.reset(options=5)
    env.close()


@pytest.mark.parametrize("num_workers", [0, 2])
def test_errors_and_calls_out_of_order_are_told_and_do_no_harm(num_workers):
    env, actions = LidarEnvs(np.int64(2), task=Explore, num_workers=num_workers, **QUICK), np.zeros((2, 2))
    with pytest.raises(gymnasium.error.ResetNeeded, match="no episodes have begun"):
        env.step(actions)
    with pytest.raises(gymnasium.error.ResetNeeded, match="first reset must start all"):
        env.reset(options={"reset_mask": np.array([True, False])})
    env.reset(seed=0)
    with pytest.raises(ValueError, match="unknown options"):
        env.reset(options={"weather": "rain"})
    with pytest.raises(gymnasium.error.ResetNeeded, match="no episodes have begun"):
        env.step(actions)
    env.reset(seed=0)
    with pytest.raises(AttributeError, match="no_such_thing"):
        env.get_attr("no_such_thing")
    for copied in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match="cannot be copied or pickled"):
            copied(env)
    gc.collect()
    env.step(actions)
    env.close()
    for call in CALLS.values():
        with pytest.raises(gymnasium.error.ClosedEnvironmentError):
            call(env)


def test_a_worker_that_dies_is_an_error(env):
    for child in multiprocessing.active_children():
        child.kill()
        child.join()
    with pytest.raises(RuntimeError, match="worker process died"):
        env.step(ACTIONS)


@pytest.mark.parametrize("start_server", ["", "multiprocessing.set_forkserver_preload(['__main__'])"])
def test_a_script_that_workers_import_is_told_to_guard_its_start(start_server, tmp_path):
    """Python 3.14 starts processes by a server by default, which imports the script already."""
    make = f'gymnasium.make_vec("lidarnaut/Explore-v0", 2, num_workers=2, context="forkserver", **{QUICK})'
    script = tmp_path / "script.py"
    script.write_text(f"import gymnasium, lidarnaut, multiprocessing\n{start_server}\n{make}.reset(seed=0)\n")
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run([sys.executable, script], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 1
    assert re.search(r"\nRuntimeError: .*which needs `if __name__ == '__main__':`\n$", done.stderr)
