"""Benchmarks of simulators, frontier decisions and crowds in one process."""

import itertools
import time
from collections.abc import Callable, Mapping
from functools import partial
from timeit import timeit
from typing import Any

import gymnasium
import numpy as np

from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation import PHYSICS, Twist, make_simulator
from lidarnaut.envs.worlds import load_world

ROOMS = {"world": "rooms", "world_size": (20.0, 20.0), "physics": "kinematic"}
NUM_DECIDING = (1, 16, 64, 256)
NUM_AMONG_PEOPLE = 64
WARM_UP, SLICES = 3, 6


def physics(repetitions: int) -> list[dict[str, Any]]:
    """Measure the time of a reset, and of a 0.1 s control step with all sensors, in each simulator [us]."""
    world, calls = load_world("turtlebot3_world"), {}
    for name in PHYSICS:
        for robot in map(load_robot, ("turtlebot3_burger", "turtlebot3_waffle_pi")):
            driven, placed = (make_simulator(name, robot, 0.1) for _ in range(2))
            start = world, [world.spawns[0]], [np.random.default_rng(0)]
            driven.reset(*start)
            label = f"{name}, {robot.name} ({robot.lidar.num_beams} beams)"
            calls[f"step, {label}"] = partial(driven.step, [Twist(0.2, robot.max_w / 2)])
            calls[f"reset, {label}"] = partial(placed.reset, *start)
    turns = [[timeit(call, number=10) for call in calls.values()] for _ in range(repetitions + 1)]
    times = 1e5 * np.array(turns[1:]).T
    return [{"what": name, "least us": us.min(), "median us": np.median(us)} for name, us in zip(calls, times)]


def decisions(count: int) -> list[dict[str, Any]]:
    """Measure decisions per second and time per step of environments whose robots drive to the nearest frontier.

    Each sub-environment, 20 m x 20 m rooms with a TurtleBot3 Burger and Hector SLAM, makes `count` decisions.
    """
    rows = []
    for number, (done, seconds) in _in_turn({number: _deciding(number) for number in NUM_DECIDING}, count).items():
        taken, steps, simulated = done
        rates = {"decisions/s": taken / seconds, "steps/decision": steps / taken, "simulated s": simulated / taken}
        rows.append({"sub-environments": number, **rates, "us/step": 1e6 * seconds / steps})
    return rows


def _in_turn(cases: Mapping[Any, Callable[[], Any]], count: int) -> dict[Any, tuple[np.ndarray, float]]:
    """Call each case `count` times in alternating slices; return the sum of its results, and processor time [s]."""
    for call in cases.values():
        for _ in range(WARM_UP):
            call()
    done, seconds = dict.fromkeys(cases, np.zeros(())), dict.fromkeys(cases, 0.0)
    for _ in range(SLICES):
        for name, call in cases.items():
            began = time.process_time()
            for _ in range(count // SLICES):
                done[name] = done[name] + call()
            seconds[name] += time.process_time() - began
    return {name: (done[name], seconds[name]) for name in cases}


def _deciding(number: int) -> Callable[[], tuple[int, int, float]]:
    id = "lidarnaut:lidarnaut/ExploreFrontiers-v0"
    if number > 1:
        envs = gymnasium.make_vec(id, number, "vector_entry_point", num_workers=0, **ROOMS)
        envs.reset(seed=0)

        def decide_in_all() -> tuple[int, int, float]:
            *_, info = envs.step(np.zeros(number, dtype=np.int64))
            taken = int(np.count_nonzero(info["outcome"] != "reset"))
            return taken, info["decision_steps"].sum(), info["decision_time"].sum()

        return decide_in_all
    env = gymnasium.make(id, **ROOMS)
    env.reset(seed=0)

    def decide() -> tuple[int, int, float]:
        *_, terminated, truncated, info = env.step(np.int64(0))
        if terminated or truncated:
            env.reset()
        return 1, info["decision_steps"], info["decision_time"]

    return decide


def people(count: int) -> list[dict[str, Any]]:
    """Measure steps per second of processor time in environments with goal reaching among people.

    Each sub-environment, a 12 m x 12 m hall with a TurtleBot3 Burger and random actions, makes `count` steps.
    """
    id, world_size, shown = "lidarnaut:lidarnaut/ReachCrowd-v0", (12.0, 12.0), ("scan_history", "goal")
    usual: dict[str, Any] = {"robot": "turtlebot3_burger", "world_size": world_size, "observations": shown}
    make = partial(gymnasium.make_vec, id, NUM_AMONG_PEOPLE, "vector_entry_point", num_workers=0, **usual)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (SLICES, NUM_AMONG_PEOPLE, 2)).astype(np.float32)

    def stepping(number: int, contact: str) -> Callable[[], int]:
        envs, turns = make(people=number, contact=contact), itertools.cycle(actions)
        envs.reset(seed=0)
        return lambda: len(envs.step(next(turns))[1])

    cases = [(number, contact) for contact in ("costs", "ends") for number in (0, 10, 30)]
    found = _in_turn({case: stepping(*case) for case in cases}, count)
    rates = {case: float(steps) / spent for case, (steps, spent) in found.items()}
    return [{"people": n, "contact": contact, "steps/s": rate} for (n, contact), rate in rates.items()]
