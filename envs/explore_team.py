"""Several robots explore one world together, with one map."""

from typing import Any

from envs.estimation import Belief
from envs.explore import OBSERVATIONS, ExploreEnv
from envs.observations import Observations

MAX_ROBOTS = 4
"""Robots of a team at most."""


class ExploreTeamEnv(ExploreEnv):
    """Explore an unknown world with a team of lidar robots that share one map.

    ## Description
    `ExploreEnv` with one to four equal robots. They start near each other and know their relative poses, as in
    Umari and Mukhopadhyay (2017). Each tracks its own pose, by matching its scans to the map that all of them integrate
    their scans into. They see each other, and they collide with each other. Beams that end at a peer, by the poses that the
    robots tell each other, are left out of the map. With one robot everything equals `ExploreEnv`.

    ## Action Space
    `Box(-1, 1, (num_robots, 2), float32)`: a row per robot, forward speed and yaw rate (counter-clockwise) as fractions
    of its limits.

    ## Observation Space
    `Dict`, a row per robot of what `ExploreEnv` shows, everything seen from that robot (fresh arrays each step):

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_robots, num_beams), float32)` | ranges, peers among what they hit |
    | `map_near` | `Box(0, 255, (num_robots, 3, 40, 40), uint8)` | the shared map, 8 m x 8 m around each robot |
    | `map_far` | `Box(0, 255, (num_robots, 3, 40, 40), uint8)` | the shared map, 32 m x 32 m around each robot |
    | `motion` | `Box(-1, 1, (num_robots, 6), float32)` | each robot's own motion, last action, bumper, time since the reset over 600 s (at most 1) |
    | `mates` | `Box(-1, 1, (num_robots, 4 * (num_robots - 1)), float32)` | four numbers for each of the others, in the order of their indices: estimated position ahead and to the left over 16 m, cosine and sine of the heading; only with two or more robots |

    Channel 2 of the maps shows where any of the robots has been.

    ## Rewards
    The sum of the terms in `info["rewards"]`, which are those of `ExploreEnv` for the team as a whole: `explored` (each
    cell once, by whichever robot), `time`, `collision` (for each robot that touches anything, peers included), `completed`.

    ## Starting State
    The robots are at rest and have no map yet; the frame of their map begins where robot 0 starts. `start` says where
    that is, as in `ExploreEnv`; the others start within 2 m of it, in its line of sight and 0.5 m apart, with any
    heading, or, where there is no room for that, further away, closer together, or out of its line of sight. One pose per robot, `((x, y, theta), ...)`, is
    taken as it is.

    ## Episode End
    1. Termination: the explored fraction reaches `target_coverage`.
    2. Truncation: `time_limit` seconds have passed.

    Collisions cost, and do not end the episode.

    ## Information
    Each step: `explored_fraction` (of the explorable area), `explored_area` [m2], `time` [s], `rewards` (terms),
    `is_success`, and per robot `pose_error` (shape (num_robots, 2): position [m], heading [rad]), `path_length` [m] and
    `collisions` (both shape (num_robots,)); at the end also `map_iou`, `area_left` [m2] and `end_reason` (`"covered"` or `"time_limit"`).

    ## Arguments
    Those of `ExploreEnv` but for `return_home`, and

    | argument | default | meaning |
    |---|---|---|
    | `num_robots` | `2` | robots, 1 to 4 |
    | `start` | `"random"` | also a pose for each robot, see Starting State |
    | `observations` | `None` | parts of the observation; `None` gives those above |

    ## Version History
    * v0: first version
    """

    is_team = True

    def __init__(self, *, num_robots: int = 2, observations: Observations | None = None, **arguments: Any) -> None:
        """See the class for the arguments.

        Raises:
            ValueError: if an argument is not among the allowed values; the message names it and them.
        """
        if num_robots not in range(1, MAX_ROBOTS + 1):
            raise ValueError(f"num_robots must be a whole number from 1 to {MAX_ROBOTS}, got {num_robots!r}")
        self.num_robots = num_robots
        if observations is None:
            observations = OBSERVATIONS if num_robots == 1 else (*OBSERVATIONS, "mates")
        super().__init__(observations=observations, **arguments)

    @property
    def beliefs(self) -> list[Belief]:
        """What each robot estimates; the map in them is one and the same."""
        return [robot.belief for robot in self.robots]
