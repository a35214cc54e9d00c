"""Exploration at the level of decisions: choose a frontier, and the robot drives there."""

from typing import Any

from envs.explore import ExploreEnv
from envs.wrappers.frontier_actions import FrontierActions


class ExploreFrontiersEnv(FrontierActions):
    """Explore an unknown world by choosing, again and again, the frontier to drive to.

    ## Description
    The world, the robot, its sensors and its SLAM are those of `ExploreEnv`. The policy does not steer: each step it
    picks one of the frontiers (free cells of the map beside unknown ones) that the robot can get to. A navigator plans
    the path with each decision (and every four seconds of a longer one), follows it, keeps clear of what the lidar
    sees, and backs up when the robot gets nowhere.
    A step ends as soon as a new decision is due, after some control steps.

    ## Action Space
    `Discrete(max_candidates)`: the candidate to go to. Candidates come by increasing cost of the path, so 0 is the
    nearest one. `action_masks()` and `info["action_mask"]` tell which actions have a candidate. An action without one
    is no error: the last candidate is taken instead, and `info["action"]` says which.

    ## Observation Space
    `Dict`, as the robot sees it when the decision is due (fresh arrays each step):

    | key | space | meaning |
    |---|---|---|
    | `candidates` | `Box(-1, 1, (max_candidates, 10), float32)` | a row per candidate; rows without one are 0 |
    | `action_mask` | `MultiBinary(max_candidates)` | 1 for rows with a candidate |
    | `map` | `Box(0, 255, (3, 40, 40), uint8)` | map around the robot, as `map_far` of `ExploreEnv` |
    | `motion` | `Box(-1, 1, (6,), float32)` | as `ExploreEnv`'s |

    Features of a candidate, with x / (x + h) for lengths, costs and times without an end:

    | column | meaning |
    |---|---|
    | 0 `gain` | share of the area within 1 m of the frontier that is unknown |
    | 1 `cost` | length of the path, weighted by nearness to obstacles; h = 5 m |
    | 2 `turn` | from the robot's heading to the beginning of the path, counter-clockwise, over pi |
    | 3 `size` | length of the frontier; h = 2 m |
    | 4 `clearance` | distance from obstacles at the viewpoint, over that from which they cost nothing |
    | 5 `age` | time for which there has been a candidate within 0.5 m, also while it moved on; h = 60 s |
    | 6 `ahead`, 7 `left` | where the frontier lies, in the robot's frame, over 16 m |
    | 8 `failures` | attempts to get here that failed, over the three after which it is no longer offered |
    | 9 `chosen` | 1 for the one nearest to the frontier that the last decision was for, and within 0.5 m of it |

    Frontiers longer than 2 m are split. If there are more than `max_candidates`, the cheapest to get to are offered.
    Frontiers that the robot has looked at from as near as it gets, and which are there still, are not offered again.

    ## Rewards
    The sum of `ExploreEnv`'s reward over the control steps of the decision, term by term in `info["rewards"]`.

    ## Starting State
    As `ExploreEnv`'s.

    ## Episode End
    1. Termination: the explored fraction reaches `target_coverage`.
    2. Termination: no frontier is left that the robot could get to, after it has looked around once more. The robot is
       stuck if no cell of its map near it is traversable, or it has not come ten centimetres far for half a minute.
    3. Truncation: `time_limit` seconds have passed; decisions are cut short.

    A decision is due when the robot has arrived, when its frontier is gone (and at least a second has passed), when it
    has not come half a metre far for ten seconds or there is no path any more, or when the drive has taken
    `max_decision_time`. A recovery is finished first, and looking around, where no frontier is left, comes
    on top: `decision_time` counts both. To go on to the same frontier, choose it again: `chosen` marks it.

    ## Information
    What `ExploreEnv` gives, and each step: `action_mask` (int8), `action` (the candidate that was taken; -1 where there
    was none and the robot looked around), `outcome` (`"arrived"`, `"frontier_gone"`, `"failed"`, `"time_up"`,
    `"looked_around"`, `"episode_end"`; `"reset"` after one), `decision_time` [s], `decision_length` [m],
    `decision_steps` (control steps), `area_left` (explorable and unknown) [m2]. `end_reason` may also be
    `"no_reachable_frontier"` or `"stuck"`.

    ## Arguments
    Those of `ExploreEnv`, and

    | argument | default | meaning |
    |---|---|---|
    | `max_candidates` | `24` | frontiers that are offered at most |
    | `max_decision_time` | `4.0` | longest drive, but for recoveries and looking around [s] |
    | `control_hz` | `5.0` | control steps per second |

    ## Version History
    * v0: first version
    """

    metadata = ExploreEnv.metadata

    def __init__(
        self,
        *,
        max_candidates: int = 24,
        max_decision_time: float = 4.0,
        control_hz: float = 5.0,
        **arguments: Any,
    ) -> None:
        """See the class for the arguments.

        Raises:
            ValueError: if an argument is not among the allowed values; the message names it and them.
        """
        super().__init__(
            ExploreEnv(control_hz=control_hz, **arguments),
            max_candidates=max_candidates,
            max_decision_time=max_decision_time,
        )
