"""Team exploration environment with actions that choose frontiers."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from gymnasium import spaces

from lidarnaut.envs.decisions.explore_frontiers import EPISODE_END, ExploreFrontiersEnv
from lidarnaut.envs.navigation import Markers
from lidarnaut.envs.navigation.teams.team_navigator import UNASSIGNED, TeamNavigator, discount
from lidarnaut.envs.navigation.teams.team_robot import TeamRobot
from lidarnaut.envs.observations import Peers
from lidarnaut.envs.observations.positions import PEERS_RANGE
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.tasks.explore import ExploreTeam


class ExploreTeamFrontiersEnv(ExploreFrontiersEnv):
    """Explore an unknown world with a team by choosing the next frontier of one robot at a time.

    ## Description
    Team, shared map and start are those of `ExploreTeam-v0`, decisions those of `ExploreFrontiers-v0`. A step is the
    decision of the robot that has finished its drive, and lasts until any robot needs a decision. Policies of
    `ExploreFrontiers-v0` that ignore `peers` run unchanged. Robots that meet yield as in `rrt_team`.

    The visible unknown area of candidates within 2 m of another robot's target counts in proportion to that distance.

    ## Action Space
    As in `ExploreFrontiers-v0`, for the robot `info["robot"]`.

    ## Observation Space
    `Dict` for the deciding robot, as in `ExploreFrontiers-v0`:

    | key | space | meaning |
    |---|---|---|
    | `candidates` | `Box(-1, 1, (max_candidates, 15), float32)` | one row per candidate; `chosen` refers to this robot |
    | `sectors` | `Box(0, 1, (max_candidates, 48), float32)` | view from the viewpoint |
    | `gaps` | `Box(0, 1, (max_candidates, max_candidates), float32)` | distances between candidates |
    | `action_mask` | `MultiBinary(max_candidates)` | 1 for valid candidates |
    | `map` | `Box(0, 255, (3, 40, 40), uint8)` | shared map around the robot; channel 2 shows the paths of all robots |
    | `robot` | `Box(0, 1, (3,), float32)` | lidar range, radius, maximum speed |
    | `peers` | `Box(-1, 1, (7 * (num_robots - 1),), float32)` | for each other robot, by index: position ahead and left / 16 m, cosine and sine of the heading; 1 if it drives to a frontier, and frontier position ahead and left / 16 m |

    ## Rewards
    `ExploreTeam-v0` reward, summed since the last decision of any robot.

    ## Starting State
    As in `ExploreTeam-v0`.

    ## Episode End
    1. Termination: the explored fraction reaches `target_coverage`.
    2. Termination: no robot can reach a frontier. A robot without candidates waits for the other robots.
    3. Truncation: `time_limit` seconds have passed, also during a decision.

    ## Information
    As in `ExploreFrontiers-v0` and `ExploreTeam-v0`, and `robot`, the index of the deciding robot. `decision_time`,
    `decision_steps` and `decision_length` (of all robots) count from the last decision of any robot. `outcome` is that
    of the deciding robot's last drive.

    ## Arguments
    As in `ExploreFrontiers-v0`, without `return_home` and `collision_monitor`, and

    | argument | default | meaning |
    |---|---|---|
    | `num_robots` | `2` | number of robots, 1 to 4 |
    | `start` | `"random"` | also one pose per robot, see `ExploreTeam-v0` |

    ## Version History
    * v0: first version
    """

    task_kind = ExploreTeam
    ignores = dict.fromkeys(("observations", "clip_actions", "collision_monitor", "cost"), "lidarnaut/ExploreTeam-v0")
    ignores["return_home"] = "lidarnaut/ExploreFrontiers-v0"

    def __init__(self, *, num_robots: int = 2, **arguments: Any) -> None:
        super().__init__(num_robots=num_robots, **arguments)
        self._peers = Peers(num_robots - 1)
        if num_robots > 1:
            assert isinstance(self.observation_space, spaces.Dict)
            box = spaces.Box(-1.0, 1.0, (7 * (num_robots - 1),), np.float32)
            self.observation_space = spaces.Dict({**self.observation_space.spaces, "peers": box})

    @property
    def deciding(self) -> Robot:
        return self.explore.robots[self.navigator.index if isinstance(self.navigator, TeamRobot) else 0]

    @property
    def why_not_fused(self) -> str:
        return "robots of a team react to each other in every control period"

    def observe(self, out: Mapping[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
        seen = super().observe(out)
        if "peers" not in seen:
            return seen
        rows, poses = seen["peers"].reshape(-1, 7), np.empty((len(self._team.team) - 1, 4), dtype=np.float32)
        self._peers.write(self.deciding, poses.reshape(-1))
        rows[:, :4], rows[:, 4:] = poses, 0.0
        targets = self._team.targets
        del targets[self.deciding.index]
        for row, target in zip(rows, targets, strict=True):
            if target is not None:
                ahead = self.belief.pose.inverse().transform(np.array([target]))[0]
                row[4], row[5:] = 1.0, np.clip(ahead / PEERS_RANGE, -1.0, 1.0)
        return seen

    def _begin(self) -> None:
        explore, numbers = self.explore, range(len(self.explore.robots))
        team = [TeamRobot(explore.robot_params, explore.control_period, k, **self._limits) for k in numbers]
        self._team, explore.overlay.markers = TeamNavigator(explore.robot_params, team), partial(Markers.of, team)
        self._due = self._update()
        self._turn(self._due.pop(0) if self._due else team[0])

    def _update(self) -> list[TeamRobot]:
        robots = self.explore.robots
        due = self._team.update([robot.reading for robot in robots], [robot.belief for robot in robots])
        idle = [robot for robot in due if len(robot.candidates) == 0]
        self._team.choose(idle, [UNASSIGNED] * len(idle))
        return [robot for robot in due if len(robot.candidates)]

    def _turn(self, robot: TeamRobot) -> None:
        self.navigator = robot
        for peer, target in zip(self._team.team, self._team.targets, strict=True):
            if peer is not robot and peer not in self._due and target is not None:
                discount(robot.candidates, target)

    def _choose(self, index: int) -> None:
        assert isinstance(self.navigator, TeamRobot)
        self._team.choose([self.navigator], [index])

    def _drive(self) -> str:
        explore = self.explore
        while not self._due:
            explore.overlay.plans[:] = self._team.plans
            if self._team.end_reason is not None:
                return EPISODE_END
            self._control(*(robot.command(explore.robots[robot.index].belief) for robot in self._team.team))
            if any(explore.is_over):
                self.navigator.look(self.deciding.reading, self.belief)
                return EPISODE_END
            self._due = self._update()
        robot = self._due.pop(0)
        self._turn(robot)
        explore.overlay.plans[:] = self._team.plans
        return str(robot.outcome)

    @property
    def _end_reason(self) -> str | None:
        return self._team.end_reason

    def _info(self) -> dict[str, Any]:
        return super()._info() | {"robot": self.deciding.index}
