"""Custom SLAM: mapping with known motions whose turns are scaled by 98 %, to show the effect.

This example modifies `KnownPoses`. Other SLAMs are subclasses of `lidarnaut.envs.slam.key_scans.KeyScanSlam` with
`match`, or of `lidarnaut.envs.estimation.Estimator` with `update`.
"""

import gymnasium
import numpy as np
import tyro

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut import make_policy, run_episode
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.simulation import Reading
from lidarnaut.envs.slam import KnownPoses


class Forgetful(KnownPoses):
    """Mapping at the odometry pose, with turns scaled by 98 %; pass it or "own_slam:Forgetful" as `slam=`."""

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        """Process a reading and the motion since the last reading."""
        return super().update(reading, motion._replace(theta=0.98 * motion.theta))


def main(seconds: float = 60.0) -> dict[str, float]:
    """Explore with this SLAM and with Hector; return the heading RMSE of each [rad].

    Args:
        seconds: Simulated time [s].
    """
    errors = {}
    for name, slam in (("forgetful", Forgetful), ("hector", "hector")):
        env = gymnasium.make(
            "lidarnaut/Explore-v0", world="turtlebot3_world", slam=slam, physics="kinematic", time_limit=seconds
        )
        errors[name] = run_episode(env, make_policy("nearest"), seed=0).heading_rmse
        env.close()
        print(f"{name}: heading off by {np.degrees(errors[name]):.1f} degrees (RMSE)")
    return errors


if __name__ == "__main__":
    tyro.cli(main)
