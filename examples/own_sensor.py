"""A sensor of one's own, outside of the checkout: radio beacons that measure the distance to the robot, with noise.

A sensor is made of ground truth, which observation parts do not see; a wrapper does. Noise comes from a generator that
the reset seeds, so that episodes repeat exactly. Sensors that SLAM or navigation are to use are added to the
simulation: see "Add a sensor" in CONTRIBUTING.md.
"""

from typing import Any

import gymnasium
import numpy as np
import tyro
from gymnasium import spaces

import envs  # noqa: F401  (registers the environments)


class Beacons(gymnasium.Wrapper):
    """Adds `beacons` to observations: distances to beacons at known positions, over `range_max`."""

    def __init__(self, env: gymnasium.Env, positions: np.ndarray, std: float = 0.1, range_max: float = 20.0) -> None:
        """Take positions of the beacons, shape (n, 2), world frame [m], and the standard deviation of the noise [m]."""
        super().__init__(env)
        self._positions, self._std, self._range_max = np.asarray(positions), std, range_max
        box = spaces.Box(0.0, 1.0, (len(positions),), np.float32)
        self.observation_space = spaces.Dict({**env.observation_space.spaces, "beacons": box})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode; `seed` also seeds the noise."""
        observation, info = self.env.reset(seed=seed, options=options)
        if seed is not None or not hasattr(self, "_rng"):
            self._rng = np.random.default_rng(None if seed is None else [seed, 2])
        return self._measure(observation), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Drive for one control period."""
        observation, *outcome = self.env.step(action)
        return self._measure(observation), *outcome

    def _measure(self, observation: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        pose = self.env.unwrapped.truths[0].state.pose
        distances = np.hypot(*(self._positions - (pose.x, pose.y)).T)
        distances += self._std * self._rng.standard_normal(len(distances))
        beacons = np.clip(distances / self._range_max, 0.0, 1.0).astype(np.float32)
        return {**observation, "beacons": beacons}


def main(steps: int = 50) -> np.ndarray:
    """Drive ahead for some steps; return what the beacons measured, shape (steps + 1, 3)."""
    env = gymnasium.make("lidarnaut/Explore-v0", world="turtlebot3_world", physics="kinematic")
    env = Beacons(env, np.array([[-2.0, -2.0], [2.0, -2.0], [0.0, 2.5]]))
    observation, _ = env.reset(seed=0)
    measured = [observation["beacons"]]
    for _ in range(steps):
        observation, *_ = env.step(np.array([0.5, 0.2], dtype=np.float32))
        measured.append(observation["beacons"])
    env.close()
    print(f"distances at the end: {np.round(20.0 * measured[-1], 2)} m")
    return np.array(measured)


if __name__ == "__main__":
    tyro.cli(main)
