"""Environment for frontier exploration without simulated driving."""

from typing import Any

from lidarnaut.envs.decisions.explore_frontiers import ExploreFrontiersEnv
from lidarnaut.envs.simulation.slide import SlideParams


class ExploreFrontiersAbstractEnv(ExploreFrontiersEnv):
    """Explore by choosing frontiers, with a robot that moves along planned paths.

    ## Description
    `ExploreFrontiers-v0` with `physics="slide"`. The simulation is about
    twice as fast: the robot is moved along the planned path, and scans are integrated at intervals, at an estimated
    pose with a drifting error. Wheels, contacts, scan matching and recoveries are not simulated. Evaluate results in
    `ExploreFrontiersEnv`; docs/concepts/explore_frontiers.md compares both.

    ## Action Space
    As in `ExploreFrontiersEnv`.

    ## Observation Space
    As in `ExploreFrontiersEnv`.

    ## Rewards
    As in `ExploreFrontiersEnv`, without collisions.

    ## Starting State
    As in `ExploreFrontiersEnv`.

    ## Episode End
    As in `ExploreFrontiersEnv`.

    ## Arguments
    As in `ExploreFrontiersEnv`, without `return_home`, `people`, `track_people`, `sensors`, `collision_monitor` and
    lidars with a `scan_time`; `randomize` accepts lidar parameters only, and `reward` no speeds, actions or gaps to
    people.

    | argument | default | meaning |
    |---|---|---|
    | `physics` | `"slide"` | fixed; `"kinematic"`, its name in earlier versions, means the same |
    | `slam` | `"truth"` | fixed |
    | `map_resolution` | `0.2` | side of a map cell [m] |
    | `scan_distance` | `0.4` | path length between integrated scans [m] |
    | `drift` | `(0.03, 0.005)` | standard deviation of the estimated pose: position [m], heading [rad] |
    | `false_returns` | `0.0002` | fraction of beams that end early |

    ## Version History
    * v0: first version
    """

    def __init__(
        self,
        *,
        physics: str = "slide",
        slam: str = "truth",
        map_resolution: float = 0.2,
        scan_distance: float = SlideParams.scan_distance,
        drift: tuple[float, float] = SlideParams.drift,
        false_returns: float = SlideParams.false_returns,
        **arguments: Any,
    ) -> None:
        for name, value, allowed in (("physics", physics, ("slide", "kinematic")), ("slam", slam, ("truth",))):
            if value not in allowed:
                raise ValueError(f"{name} must be {allowed[0]!r} in this environment, got {value!r}")
        params = SlideParams(scan_distance, drift, false_returns)
        super().__init__(physics="slide", slam=slam, map_resolution=map_resolution, **arguments)
        self.explore.simulator.params = params
