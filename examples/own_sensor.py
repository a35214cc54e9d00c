"""Custom sensor: radio beacons that measure distances to the robot, with noise.

A sensor computes a measurement from ground truth with its own random generator, for reproducible episodes. Readings
hold the measurement (`reading.extra["beacons"]`). The sensor's name is also an observation part with the raw
measurement; `Nearness` is a scaled one. An EKF fuses the distances with the wheel encoders.
"""

import gymnasium
import numpy as np
import tyro
from gymnasium import spaces

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut import RobotParams
from lidarnaut.envs.localization.ekf import Measurement
from lidarnaut.envs.localization.fusion import make_filter, measure_wheels, start_covariance
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.simulation import Simulator
from lidarnaut.envs.worlds import World

POSITIONS = np.array([[-2.0, -2.0], [2.0, -2.0], [0.0, 2.5]])
"""Positions of the beacons, shape (n, 2), world frame [m]."""
STD = 0.1
"""Standard deviation of the distance noise [m]."""


class Beacons:
    """Sensor of distances to the beacons, shape (n,), float64 [m]."""

    name = "beacons"
    shape = (len(POSITIONS),)

    def reset(self, world: World, rng: np.random.Generator) -> None:
        """Start an episode; use `rng` for noise."""
        self._rng = rng

    def measure(self, simulator: Simulator, robot: int) -> np.ndarray:
        """Return the measurement of a robot."""
        distances = np.hypot(*(POSITIONS - simulator.states[robot].pose[:2]).T)
        return np.asarray(distances + STD * self._rng.standard_normal(len(distances)))


class Nearness:
    """Nearness of each beacon: 1 at the beacon, halved every three metres."""

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return the space of the observation part."""
        return spaces.Box(0.0, 1.0, Beacons.shape, np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the observation to `out`, shape (n,), float32."""
        out[:] = np.minimum(0.5 ** (robot.reading.extra["beacons"] / 3.0), 1.0)


def main(steps: int = 50) -> np.ndarray:
    """Drive ahead and return the measured distances, shape (steps + 1, 3) [m]."""
    observations = {"scan": None, "beacons": None, "nearness": Nearness}
    env = gymnasium.make("lidarnaut/Explore-v0", sensors=[Beacons()], observations=observations, physics="kinematic")
    observation, _ = env.reset(seed=0)
    robot, start, measured = env.unwrapped.robots[0], env.unwrapped.map_pose, [observation["beacons"]]
    # Encoders and beacons localize the robot without lidar, here from a start that is 0.3 m wrong.
    ekf, before = make_filter(robot.params, robot.control_period), robot.reading
    ekf.reset(start._replace(x=start.x + 0.3), start_covariance(0.3, 0.3), time=before.time)
    for _ in range(steps):
        observation, *_ = env.step(np.array([0.5, 0.2], dtype=np.float32))
        measured.append(observation["beacons"])
        last, before = before, robot.reading
        left, right = np.subtract(before.ticks, last.ticks).tolist()
        ekf.add(measure_wheels(robot.params, before.time, before.time - last.time, (left, right)))
        for position, distance in zip(POSITIONS.tolist(), before.extra["beacons"], strict=True):
            ekf.add(Measurement(before.time, "landmark", np.array([distance]), np.array([[STD**2]]), tuple(position)))
    estimate, truth = ekf.estimate(), env.unwrapped.truths[0].state.pose
    env.close()
    print(f"distances at the end: {np.round(measured[-1], 2)} m; nearness {np.round(observation['nearness'], 2)}")
    print(f"position error of the EKF: {np.hypot(estimate.pose.x - truth.x, estimate.pose.y - truth.y):.3f} m")
    return np.array(measured)


if __name__ == "__main__":
    tyro.cli(main)
