"""Record an episode as a ROS 2 bag, convert it to arrays, and replay both through SLAMs, without ROS.

`python examples/replay_bag.py --bag my.bag` takes a ROS 1 bag, a folder with a ROS 2 bag, or an .mcap file.
"""

from pathlib import Path

import gymnasium
import numpy as np
import tyro

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut import make_policy, run_episode
from lidarnaut.envs.logs import load_log
from lidarnaut.envs.logs.replay import Options
from lidarnaut.envs.logs.replay import main as replay
from lidarnaut.envs.wrappers import RecordBag


def convert(bag: Path, archive: Path) -> Path:
    """Convert odometry and scans of a bag to the arrays that `load_log` reads."""
    log = load_log(bag)
    np.savez_compressed(
        archive,
        t=log.times,
        odo=log.odometry,
        idx=log.scan_rows,
        ranges=log.ranges,
        ang0=log.lidar.angle_min + log.lidar.mount.yaw,
        dang=log.lidar.angle_increment,
        maxr=log.lidar.range_max,
        mount_x=log.lidar.mount.x,
    )
    return archive


def main(bag: Path | None = None, out: Path = Path("runs/replay_bag"), seconds: float = 30.0) -> dict[str, float]:
    """Replay a bag through two SLAMs; return the fraction of beams that conflict with each map.

    Args:
        bag: Bag to replay; without one, a simulated episode is recorded.
        out: Folder of bag, arrays, maps and trajectories.
        seconds: Duration of the recorded episode [s].
    """
    out.mkdir(parents=True, exist_ok=True)
    if bag is None:
        env = gymnasium.make("lidarnaut/ExploreTurtleBot3World-v0", physics="kinematic", time_limit=seconds)
        with RecordBag(env, out) as recorded:
            run_episode(recorded, make_policy("nearest"), seed=0)
        bag = out / "episode_0.mcap"
    archive = convert(bag, out / "log.npz")
    conflicts = {}
    for path, slam in ((bag, "hector"), (archive, "tinyslam")):
        (run,) = replay(Options(path, slam=slam, preset="default", out=out / slam))
        conflicts[slam] = run.conflict_share
    return conflicts


if __name__ == "__main__":
    tyro.cli(main)
