import multiprocessing
import os
import pickle
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence as same
from gymnasium.vector import AutoresetMode

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.vector import LidarEnvs, LidarVectorEnv
from lidarnaut.envs.worlds import world_sampler
from tests.rollouts import step_both
from tests.vector.pairs import both

ID = "lidarnaut/Explore-v0"
QUICK = {"world": "rooms", "world_size": (6.0, 6.0), "physics": "kinematic", "control_hz": 5.0, "slam": "odometry"}
ROBOT = {"robot": "turtlebot3_burger", "world_size": None, "time_limit": 1.0}
ROOMS = world_sampler("rooms", size=(6.0, 6.0), radius=0.1)
MODES = [(AutoresetMode.NEXT_STEP, 1), (AutoresetMode.SAME_STEP, 2)]


def threads(rng):
    """Draw a world with a thread that starts a program by forking in Python."""
    with ThreadPoolExecutor(1) as pool:
        pool.submit(subprocess.run, ["true"], preexec_fn=os.setpgrp).result()
    return ROOMS(rng)


def pool(rng):
    """Draw a world with processes that are replaced."""
    with multiprocessing.get_context("fork").Pool(1, maxtasksperchild=1) as pool:
        pool.map(abs, [1, 2], chunksize=1)
    return ROOMS(rng)


def spawning(rng):
    return ROOMS(rng.spawn(2)[1])


class Counting:
    def __init__(self):
        self.count = 0

    def __call__(self, rng):
        self.count += 1
        return ROOMS(np.random.default_rng(self.count))


class Sometimes:
    def __call__(self, rng):
        if rng.random() < 0.4:
            raise ValueError("no world")
        return ROOMS(rng)


@dataclass(kw_only=True, eq=False)
class Drawing(Explore):
    def reset(self, simulator, robots, rng, options):
        self.rng = rng
        return super().reset(simulator, robots, rng, options)

    def metrics(self):
        return super().metrics() | {"drawn": self.rng.random()}


class Levels(gymnasium.Wrapper):
    """Makes worlds larger: when it is called, or with each of its resets."""

    size = 6.0

    def set_size(self, size):
        task = self.unwrapped.task
        task.world_size = size, size
        task._sample = task._sampler(task.world)

    def reset(self, **arguments):
        if self.size is not None:
            self.size += 0.5
            self.set_size(self.size)
        return super().reset(**arguments)


class Called(Levels):
    size = None


OWN = {
    "task that draws": {"task": Drawing, "time_limit": 1.0},
    "threads": {"world": threads, **ROBOT},
    "processes": {"world": pool, **ROBOT},
    "spawning": {"world": spawning, **ROBOT},
    "several": {"world": ["rooms", "turtlebot3_world", spawning], **ROBOT},
    "made once": {"num_worlds": 3, "time_limit": 1.0},
}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(("case", "mode", "num_workers"), [(case, *MODES[k % 2]) for k, case in enumerate(OWN)])
def test_worlds_and_tasks_of_users_do_as_in_single_environments(case, mode, num_workers):
    worlds = set()
    with both(ID, mode, num_workers, {**QUICK, **OWN[case]}) as (ours, theirs):
        for _ in step_both(ours, theirs, np.full((14, 3, 2), 0.3)):
            worlds |= {world.segments.tobytes() for world in ours.get_attr("world")}
    assert len(worlds) >= (2 if case == "made once" else 6)


def test_samplers_with_a_memory_are_called_for_the_worlds_that_are_needed_alone():
    sampler = Counting()
    ours = LidarEnvs(2, task=Explore, num_workers=1, **{**QUICK, **ROBOT, "world": sampler})
    for num_resets in range(1, 4):
        ours.reset(seed=0)
        assert sampler.count == 2 * num_resets
    ours.close()


@pytest.mark.parametrize(("wrapper", "mode", "num_workers"), [(Called, *MODES[0]), (Levels, *MODES[1])])
def test_the_next_episode_has_the_next_level(wrapper, mode, num_workers):
    with both(ID, mode, num_workers, {**QUICK, "time_limit": 1.0}, [wrapper]) as envs:
        for k, _ in enumerate(step_both(*envs, np.full((20, 3, 2), 0.3))):
            if wrapper is Called and k in (2, 4, 11):  # also in the step that ends an episode
                for env in envs:
                    env.call("set_size", 7.0 + 0.5 * k)
        sizes = [float(np.ptp(world.segments[:, ::2])) for world in envs[0].get_attr("world")]
    assert min(sizes) > 7.0


def test_errors_of_samplers_are_raised_when_the_world_is_needed_and_then_gone():
    outcomes = [], []
    with both(ID, AutoresetMode.NEXT_STEP, 1, {**QUICK, **ROBOT, "world": Sometimes()}, num_envs=1) as envs:
        for env, seen in zip(envs, outcomes):
            for k in range(8):
                try:
                    seen.append(env.reset(seed=k if k in (0, 5) else None)[0])
                    seen += [env.step(np.zeros((1, 2)))[0] for _ in range(7)]
                except ValueError as error:
                    seen.append(str(error))
    assert same(*outcomes)
    assert 3 <= outcomes[0].count("no world") < 8


class Unpreparable(LidarEnv):
    def prepare(self):
        raise ValueError("not now")


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_worlds_that_cannot_be_prepared_are_drawn_later(mode):
    ours, theirs = (
        LidarVectorEnv(kind, 2, task=Explore, time_limit=1.0, num_workers=1, autoreset_mode=mode, **QUICK)
        for kind in (LidarEnv, Unpreparable)
    )
    for _ in step_both(ours, theirs, np.full((14, 2, 2), 0.3)):
        pass
    ours.close()
    theirs.close()


def test_preparing_draws_from_no_other_generator_and_copies_share_what_is_prepared():
    env = LidarEnv(Explore, **QUICK)
    env.reset(seed=0)
    state = env.np_random.bit_generator.state
    env.prepare()
    assert env.np_random.bit_generator.state == state
    copy, plain = pickle.loads(pickle.dumps(env)), LidarEnv(Explore, **QUICK)
    plain.reset(seed=0)
    first, second, third = env.reset(), copy.reset(), plain.reset()
    assert same(first, second)
    assert same(first, third)
    # A generator set by users is a seed as well.
    observations = []
    for prepares in (True, False, True):
        if prepares:
            env.prepare()
        env.np_random = np.random.default_rng(7)
        observations.append([env.reset()[0], env.reset()[0]])
    assert same(observations[0], observations[1])
    assert same(observations[0], observations[2])


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_forked_processes_leave_the_workers_of_their_parents_alone():
    code = """
import gc, multiprocessing, os, sys, time, warnings
warnings.simplefilter("ignore")
import gymnasium, lidarnaut
other = multiprocessing.get_context("fork").Process(target=time.sleep, args=(60.0,))
other.start()
v = gymnasium.make_vec("lidarnaut/Explore-v0", 2, num_workers=2, world="rooms", world_size=(6.0, 6.0))
v.reset(seed=0)
for end in ("sys.exit()", "v.self = v; del v; gc.collect()", "v.close()"):
    if (child := os.fork()) == 0:
        try:
            v.step(v.action_space.sample())
        except RuntimeError as error:
            assert "belong to the process that forked" in str(error)
        else:
            raise AssertionError("the workers have taken a step")
        assert multiprocessing.active_children() == [other]  # as without workers
        multiprocessing.process._children.clear()
        exec(end)
        raise SystemExit
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    v.step(v.action_space.sample())
v.close()
other.kill()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_process_goes_on_with_an_environment_without_workers():
    env = LidarEnvs(2, task=Explore, num_workers=1, time_limit=1.0, **QUICK)
    env.reset(seed=0)
    child = os.fork()
    if child == 0:
        alarm = threading.Timer(60.0, os._exit, (1,))
        alarm.daemon = True
        alarm.start()
    observations = [env.step(np.full((2, 2), 0.3))[0] for _ in range(14)]
    digest = sum(int(1e3 * part.sum()) for part in observations[-1].values()) % 200
    if child == 0:
        os._exit(2 + digest)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 2 + digest
    env.close()
