"""Custom robot: body, wheels and lidar; `robot="my_robot.yaml"` takes a file with these keys."""

import gymnasium
import tyro

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut import make_policy, run_episode
from lidarnaut.envs.robots import (
    BodyParams,
    Caster,
    DriveParams,
    LidarParams,
    Mount,
    OdometryNoise,
    OdometryParams,
    RobotParams,
)

ROBOT = RobotParams(
    name="my_robot",
    radius=0.17,
    max_v=0.4,
    max_w=2.0,
    max_acc_v=1.0,
    max_acc_w=3.0,
    drive=DriveParams(wheel_radius=0.035, track=0.24, slip_std=0.003),
    # Wheel parameters that the controller assumes; deviations from `drive` bias odometry.
    odometry=OdometryParams(
        wheel_radius=0.035, track=0.24, ticks_per_rev=1024, noise=OdometryNoise(heading_per_metre=0.04)
    ),
    body=BodyParams(mass=3.0, radius=0.16, height=0.1, center=(0.0, 0.0, 0.08), friction=0.0),
    casters=(Caster(x=0.11, y=0.0, radius=0.015), Caster(x=-0.11, y=0.0, radius=0.015)),
    # Lidar with a forward field of view: 181 beams over 180 degrees.
    lidar=LidarParams(num_beams=181, fov=3.1416, range_min=0.1, range_max=6.0, noise_std=0.01, mount=Mount(z=0.16)),
)


def main(seconds: float = 120.0) -> float:
    """Explore a world with the robot and return the explored fraction.

    Args:
        seconds: Simulated time [s].
    """
    env = gymnasium.make(
        "lidarnaut/Explore-v0", world="turtlebot3_world", robot=ROBOT, physics="kinematic", time_limit=seconds
    )
    episode = run_episode(env, make_policy("nearest"), seed=0)
    env.close()
    print(f"{ROBOT.name} explored {100 * episode.explored_fraction:.0f} % in {episode.duration:.0f} s")
    return episode.explored_fraction


if __name__ == "__main__":
    tyro.cli(main)
