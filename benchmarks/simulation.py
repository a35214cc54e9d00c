"""How long the simulation takes: `python -m benchmarks.simulation`.

Every figure is the least over many repetitions, in microseconds, on one core; the parts of a table are measured in
turn, so that a busy machine slows all of them alike. The second figure is the median.
"""

import math
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from benchmarks.speed.references import cast_rays_in_numpy
from envs.command_line import Count, run_command
from envs.geometry.raycast import Beams, cast_rays
from envs.robots import load_robot
from envs.simulation import PHYSICS, Twist, make_simulator
from envs.worlds import World, load_world

BEAMS, REACH = 360, 10.0


def measure(calls: dict[str, Callable[[], object]], repetitions: int, batch: int) -> dict[str, np.ndarray]:
    """Time every call `repetitions` times in batches of `batch`, one call after the other [us]."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    for _ in range(repetitions):
        for name, call in calls.items():
            start = time.perf_counter()
            for _ in range(batch):
                call()
            times[name].append(1e6 * (time.perf_counter() - start) / batch)
    return {name: np.array(values) for name, values in times.items()}


def print_table(title: str, times: dict[str, np.ndarray]) -> None:
    print(f"\n{title}")
    for name, values in times.items():
        print(f"  {name:<58} {values.min():9.1f} {np.median(values):9.1f}")


def thicket(num_segments: int) -> np.ndarray:
    """Return segments of about 0.7 m scattered over 30 x 30 m, none near the origin."""
    rng = np.random.default_rng(0)
    middles = rng.uniform(-15, 15, (4 * num_segments, 2))
    middles = middles[np.hypot(*middles.T) > 1.0][:num_segments]
    return np.hstack([middles, middles + rng.normal(0, 0.5, middles.shape)])


def ray_casting(repetitions: int) -> None:
    out = np.empty(BEAMS, dtype=np.float32)
    beams, angles = Beams(0.0, 2.0 * math.pi / BEAMS, REACH), 2.0 * math.pi / BEAMS * np.arange(BEAMS)
    calls: dict[str, Callable[[], object]] = {}
    for size in (216, 1216):
        segments = thicket(size)
        scattered = (segments, np.empty((0, 3)))
        calls[f"cast_rays, {size} scattered segments"] = partial(cast_rays, 0.0, 0.0, 0.3, beams, *scattered, out)
        calls[f"every beam against {size} segments in NumPy"] = partial(
            cast_rays_in_numpy, 0.0, 0.0, 0.3 + angles, REACH, *scattered
        )
    for name in ("turtlebot3_world", "turtlebot3_house", "tugbot_warehouse"):
        world = load_world(name)
        label = f"cast_rays, {name} ({len(world.segments)} segments, {len(world.circles)} circles)"
        calls[label] = partial(cast_rays, *world.spawns[0], beams, world.segments, world.circles, out)
    print_table(f"One scan of {BEAMS} beams, {REACH:g} m [us]", measure(calls, repetitions, batch=10))


def stepping(world: World, names: Sequence[str], repetitions: int) -> None:
    calls: dict[str, Callable[[], object]] = {}
    for physics in PHYSICS:
        for name in names:
            robot = load_robot(name)
            driven, placed = (make_simulator(physics, robot, 0.1) for _ in range(2))
            driven.reset(world, [world.spawns[0]], [np.random.default_rng(0)])
            label = f"{physics}, {name} ({robot.lidar.num_beams} beams)"
            calls[f"step, {label}"] = partial(driven.step, [Twist(0.2, robot.max_w / 2)])
            calls[f"reset, {label}"] = partial(placed.reset, world, [world.spawns[0]], [np.random.default_rng(0)])
    print_table(f"One control step of 0.1 s with all sensors, {world.name} [us]", measure(calls, repetitions, batch=10))


def main(world: str = "turtlebot3_world", repetitions: Count = 200) -> None:
    """Measure, and print.

    Args:
        world: name of a library world.
        repetitions: how often each is measured.
    """
    ray_casting(repetitions)
    stepping(load_world(world), ("turtlebot3_burger", "turtlebot3_waffle_pi"), repetitions)


if __name__ == "__main__":
    run_command(main)
