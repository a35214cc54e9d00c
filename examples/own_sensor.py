"""A sensor of one's own, outside of the checkout: radio beacons that measure their distance to the robot, with noise.

A sensor sees ground truth and makes a measurement of it, with a generator of its own, so that episodes repeat exactly.
Readings hold the measurement (`reading.extra["beacons"]`), for estimators, observation parts and recordings. The name
of a sensor is also that of an observation part that shows it as it is; `Nearness` shows it as networks like it.
"""

import gymnasium
import numpy as np
import tyro
from gymnasium import spaces

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Simulator
from lidarnaut.envs.worlds import World

POSITIONS = np.array([[-2.0, -2.0], [2.0, -2.0], [0.0, 2.5]])
"""Of the beacons, shape (n, 2), world frame [m]."""
STD = 0.1
"""Standard deviation of the noise [m]."""


class Beacons:
    """Distances to the beacons, shape (n,), float64 [m]."""

    name = "beacons"
    shape = (len(POSITIONS),)

    def reset(self, world: World, rng: np.random.Generator) -> None:
        """Start an episode in a world; noise is drawn from `rng`."""
        self._rng = rng

    def measure(self, simulator: Simulator, robot: int) -> np.ndarray:
        """Return what a robot measures now."""
        distances = np.hypot(*(POSITIONS - simulator.states[robot].pose[:2]).T)
        return np.asarray(distances + STD * self._rng.standard_normal(len(distances)))


class Nearness:
    """1 at a beacon, and half as much for every three metres away from it."""

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return the space of what `write` writes."""
        return spaces.Box(0.0, 1.0, Beacons.shape, np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write to `out`, shape (n,), float32."""
        out[:] = np.minimum(0.5 ** (robot.reading.extra["beacons"] / 3.0), 1.0)


def main(steps: int = 50) -> np.ndarray:
    """Drive ahead for some steps; return what the beacons measured, shape (steps + 1, 3) [m]."""
    # "own_sensor:Beacons" and "own_sensor:Nearness" work too, in training configurations for example.
    observations = {"scan": None, "beacons": None, "nearness": Nearness}
    env = gymnasium.make("lidarnaut/Explore-v0", sensors=[Beacons()], observations=observations, physics="kinematic")
    observation, _ = env.reset(seed=0)
    measured = [observation["beacons"]]
    for _ in range(steps):
        observation, *_ = env.step(np.array([0.5, 0.2], dtype=np.float32))
        measured.append(observation["beacons"])
    env.close()
    print(f"distances at the end: {np.round(measured[-1], 2)} m; nearness {np.round(observation['nearness'], 2)}")
    return np.array(measured)


if __name__ == "__main__":
    tyro.cli(main)
