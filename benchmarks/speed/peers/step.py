"""Random steps of one simulator: `python step.py SIMULATOR SECONDS SUB-ENVIRONMENTSxPEOPLE...`.

Prints a line of JSON for each case. Runs in the simulator's own virtual environment. Each function returns an iterator
that steps all sub-environments and yields the number of steps.
"""

import json
import os
import random
import sys
import time
from collections.abc import Iterator
from functools import partial
from itertools import count, cycle
from pathlib import Path
from typing import Any

WORLDS = Path(__file__).resolve().parent


def lidarnaut(num_envs: int, people: int, physics: str = "kinematic") -> Iterator[int]:
    from dataclasses import replace

    from lidarnaut.benchmarks.speed.cases import benchmark_robot

    robot = replace(benchmark_robot(num_beams=180), radius=0.2, max_v=1.0, max_w=1.0)
    task = {"world": str(WORLDS / "lidarnaut.yaml"), "start": "spawn", "goal": "world", "time_limit": 50.0}
    task |= {"robot": robot, "physics": physics, "observations": ("scan", "goal", "motion")}
    task |= {"people": f"{people}?model=orca"} if people else {}
    vector = {"num_envs": num_envs, "vectorization_mode": "vector_entry_point", "num_workers": 0}
    return step_gymnasium("lidarnaut:lidarnaut/ReachGoal-v0", **task, **(vector if num_envs > 1 else {}))


lidarnaut_bullet = partial(lidarnaut, physics="bullet")


def navground(num_envs: int, people: int) -> Iterator[int]:
    import yaml
    from navground.learning.config import ControlActionConfig
    from navground.learning.rewards import SocialReward

    scenario = yaml.safe_load((WORLDS / "navground.yaml").read_text())
    scenario["groups"][1]["number"] = people
    task = {"scenario": scenario, "sensor": {"type": "Lidar", "resolution": 180, "range": 10.0}, "max_duration": 50.0}
    task |= {"action": ControlActionConfig(), "reward": SocialReward(), "include_action": False}
    task["failure_condition"] = lambda agent, world: any(agent in pair for pair in world.collisions)
    return step_gymnasium("navground.learning.env:navground", **task)


def step_gymnasium(id: str, num_envs: int = 1, **arguments: Any) -> Iterator[int]:
    import gymnasium
    import numpy as np

    env: Any = gymnasium.make_vec(id, num_envs, **arguments) if num_envs > 1 else gymnasium.make(id, **arguments)
    env.reset(seed=0)
    return step(env, np.random.default_rng(0).uniform((0, -1), 1, (500, num_envs, 2)).astype(np.float32))


def step(env: Any, actions: Any) -> Iterator[int]:
    """Repeat `actions`, shape (num_steps, num_envs, ...); yield the number of steps, and close the environment."""
    num_envs = actions.shape[1]
    try:
        for action in cycle(actions if num_envs > 1 else actions[:, 0]):
            *_, terminated, truncated, _ = env.step(action)
            if num_envs == 1 and (terminated or truncated):
                env.reset()
            yield num_envs
    finally:
        env.close()


def irsim(num_envs: int, people: int) -> Iterator[int]:
    import irsim

    env = irsim.make(str(WORLDS / "irsim.yaml"), headless=True, log_level="ERROR", seed=0)
    env.delete_objects([person.id for person in env.obstacle_list[16 + people :]])
    while True:
        env.step([random.random(), random.uniform(-1.0, 1.0)])
        env.get_lidar_scan()
        if env.robot.collision or env.robot.arrive or env.time >= 50.0:
            env.reset()
        yield 1


def vmas(num_envs: int, people: int) -> Iterator[int]:
    import torch
    import vmas
    from vmas.scenarios.navigation import Scenario
    from vmas.simulator.core import Landmark, Sphere
    from vmas.simulator.dynamics.diff_drive import DiffDrive

    centres = [(0.8, 4.9), (1.1, 1.0), (1.5, 3.5), (2.4, 5.6), (2.8, 8.9), (3.2, 7.1), (4.3, 3.0), (4.8, 1.6)]
    centres += [(4.8, 8.1), (6.0, 2.9), (7.4, 3.3), (7.5, 1.5), (7.9, 7.2), (8.3, 8.6), (8.4, 5.0)]

    class Pillars(Scenario):
        def make_world(self, *args: Any, **kwargs: Any) -> Any:
            world = super().make_world(*args, **kwargs)
            robot = world.agents[0]
            robot.sensors[0].entity_filter, robot.dynamics = lambda entity: entity.collides(robot), DiffDrive(world)
            robot.dynamics.agent = robot
            for number in range(len(centres)):
                world.add_landmark(Landmark(f"pillar {number}", shape=Sphere(0.3), collide=True))
            return world

        def reset_world_at(self, env_index: int | None = None) -> None:
            super().reset_world_at(env_index)
            for landmark, centre in zip(self.world.landmarks[1:], torch.tensor(centres) - 5.0):
                landmark.set_pos(centre, env_index)

    settings = {"world_spawning_x": 5.0, "world_spawning_y": 5.0, "enforce_bounds": True, "n_agents": 1}
    settings |= {"agent_radius": 0.2, "n_lidar_rays": 180, "lidar_range": 10.0, "max_steps": 500, "seed": 0}
    env = vmas.make_env(Pillars(), num_envs, **settings)
    env.reset()
    while True:
        _, _, done, _ = env.step([torch.rand(num_envs, 2) * torch.tensor([1.0, 2.0]) - torch.tensor([0.0, 1.0])])
        for index in done.nonzero().flatten().tolist():
            env.reset_at(index)
        yield num_envs


def jaxnav(num_envs: int, people: int) -> Iterator[int]:
    import jax
    import jax.numpy as jnp
    from jaxmarl.environments.jaxnav.jaxnav_env import JaxNav

    lidar = {"lidar_num_beams": 180, "lidar_max_range": 10.0}
    env = JaxNav(num_agents=1, map_params={"map_size": (12, 12)}, **lidar, max_w=1.0)
    _, start = env.reset(jax.random.key(22))  # a map with 15 squares
    states = jax.tree.map(lambda value: jnp.broadcast_to(value, (num_envs, *jnp.shape(value))), start)

    def step_all(states: Any, key: jax.Array) -> Any:
        actions = {"agent_0": jax.random.uniform(key, (num_envs, 2), minval=jnp.array([0.0, -1.0]))}
        step = jax.vmap(env.step, (0, 0, 0, None))
        observations, states, rewards, dones, _ = step(jax.random.split(key, num_envs), states, actions, start)
        return states, (observations, rewards, dones)

    step_often = jax.jit(lambda states, key: jax.lax.scan(step_all, states, jax.random.split(key, 20)))
    for key in map(jax.random.key, count()):
        states, _ = jax.block_until_ready(step_often(states, key))
        yield 20 * num_envs


if __name__ == "__main__":
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # simulators print
    simulator, duration, *cases = sys.argv[1:]
    for case in cases:
        num_envs, people = map(int, case.split("x"))
        simulation = globals()[simulator](num_envs, people)
        for least in (3, 1):  # the first is the warm-up
            counts, began, used = [], time.perf_counter(), time.process_time()
            while time.perf_counter() - began < float(duration) or len(counts) < least:
                counts.append(next(simulation))
        seconds = time.process_time() - used  # without other load of the core
        answer = {"num_envs": num_envs, "people": people, "steps": sum(counts), "seconds": seconds}
        print(json.dumps(answer), file=answers, flush=True)
