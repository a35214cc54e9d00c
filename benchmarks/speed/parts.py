"""Benchmarks of simulators, frontier decisions and crowds in one process."""

import time
from collections.abc import Callable
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
    deciding = {number: _deciding(number) for number in NUM_DECIDING}
    done = {number: np.zeros(4) for number in deciding}
    for decide in deciding.values():
        for _ in range(WARM_UP):
            decide()
    for turn in range(SLICES):
        for number, decide in deciding.items():
            began = time.process_time()
            for _ in range(count * (turn + 1) // SLICES - count * turn // SLICES):
                done[number][:3] += decide()
            done[number][3] += time.process_time() - began
    rows = []
    for number, (taken, steps, simulated, seconds) in done.items():
        rates = {"decisions/s": taken / seconds, "steps/decision": steps / taken, "simulated s": simulated / taken}
        rows.append({"sub-environments": number, **rates, "us/step": 1e6 * seconds / steps})
    return rows


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
    cases = [(number, contact) for contact in ("costs", "ends") for number in (0, 10, 30)]
    among = {(number, contact): make(people=number, contact=contact) for number, contact in cases}
    rng, seconds = np.random.default_rng(0), dict.fromkeys(among, 0.0)
    actions = rng.uniform(-1.0, 1.0, (SLICES, NUM_AMONG_PEOPLE, 2)).astype(np.float32)
    for turn in range(SLICES + 1):
        for case, envs in among.items():
            if turn == 0:
                envs.reset(seed=0)
            began = time.process_time()
            for _ in range(WARM_UP if turn == 0 else count // SLICES):
                envs.step(actions[turn - 1])
            seconds[case] += (time.process_time() - began) * (turn > 0)
    steps = NUM_AMONG_PEOPLE * SLICES * (count // SLICES)
    rates = {case: steps / spent for case, spent in seconds.items()}
    return [{"people": n, "contact": contact, "steps/s": rate} for (n, contact), rate in rates.items()]
