"""Seed 2's explorer for several robots with one map.

Each robot has a local tree; all share a global tree, the filter and the assigner. After Umari and Mukhopadhyay,
"Autonomous Robotic Exploration Based on Multiple Rapidly-exploring Randomized Trees" (2017), who ran it on two and
three robots. What `rrt.py` says of one robot holds for each; besides:

- *Who is asked.* Points are assigned whenever a robot has none: to all robots without one together. The others keep
  theirs, and what those will see there is no gain any more. A robot for which no point is left stands and waits.
- *Who goes first.* A robot's plans lead around mates of lower index, and through those of higher index or without a
  point: these give way. One that is held up by such a mate makes it drive off its path, and wait there until it has
  passed. A mate that has nowhere to go lets the other one give way; if neither can, the point is given up.
- *Mates as obstacles.* Robots tell each other where they believe to be. Scans are rid of mates before they are
  remembered, and outlines take their place, which move on with them and are there also where the lidar is blind.
"""

import numpy as np

from baselines.goal_explorer import GOAL_RADIUS
from baselines.navigator import NO_POINTS, Status
from baselines.rrt.assigner import NOBODY, assign
from baselines.rrt.detector import RrtDetector
from baselines.rrt.params import TEAM_PARAMS, RrtParams
from baselines.rrt.right_of_way import is_beside, outline
from baselines.rrt.team_robot import TeamRobot
from baselines.survey import Survey
from envs.geometry import Pose2D
from envs.robots import RobotParams
from envs.slam import Belief
from envs.team import MateFilter

BLOCKING_REACH = 1.5
"""How far ahead on a robot's path a mate holds it up [m]."""
MATE_GAP = 0.05
"""Gap that is kept to a mate besides that to other obstacles, since it moves [m]."""
LOOK_AHEAD = 0.5
"""A mate is an obstacle also where it will be after this time [s]."""


class RrtTeam:
    """Explores with several robots."""

    def __init__(self, params: RrtParams = TEAM_PARAMS) -> None:
        """Make a team with the given parameters."""
        self._params = params
        self._members: list[TeamRobot] = []

    def reset(self, robot: RobotParams, control_period: float, num_robots: int, rng: np.random.Generator) -> None:
        """Prepare for a new episode.

        Args:
            robot: the robots that will be driven.
            control_period: time between two calls of `act` [s].
            num_robots: how many there are.
            rng: source of every random draw of the episode.
        """
        self._robot = robot
        self._detector = RrtDetector(self._params, rng)
        self._members = [TeamRobot(self._params, k, self.assign, self._is_anyone_on_the_way) for k in range(num_robots)]
        for member in self._members:
            member.join(robot, control_period, rng, self._detector)
        self._without_mates = MateFilter(robot)

    @property
    def end_reason(self) -> str | None:
        """Why the team has stopped exploring; None while any of its robots has not."""
        reasons = [member.end_reason for member in self._members]
        if None in reasons or not reasons:
            return None
        return "no_reachable_frontier" if "no_reachable_frontier" in reasons else reasons[0]

    def _is_anyone_on_the_way(self) -> bool:
        return any(member.target is not None for member in self._members)

    @property
    def plans(self) -> list[np.ndarray | None]:
        """The planned path of each robot for drawing, shape (n, 2), map frame [m]; None without one."""
        return [member.plan for member in self._members]

    @property
    def points(self) -> np.ndarray:
        """Frontier points that have passed the filter, shape (n, 2), float64, map frame [m]."""
        return self._detector.points

    @property
    def targets(self) -> list[tuple[float, float] | None]:
        """The frontier point of each robot (x, y), map frame [m]; None for a robot without one."""
        return [member.target for member in self._members]

    def act(self, observation: dict[str, np.ndarray], beliefs: list[Belief]) -> np.ndarray:
        """Return the actions.

        Args:
            observation: of `ExploreTeamEnv`.
            beliefs: what each robot believes; one map in all of them.

        Returns:
            Shape (num_robots, 2), float32.
        """
        if not self._members:
            raise RuntimeError("call reset before act")
        if self.end_reason is not None:
            return np.zeros((len(self._members), 2), dtype=np.float32)
        self._beliefs = beliefs
        self._detector.detect(beliefs[0].grid, [belief.pose[:2] for belief in beliefs])
        for member in self._members:
            if any(mate.target is not None for mate in self._members if mate is not member):
                member.revive()
            if member.is_held_up:
                self._clear_the_way(member)
        # All sense before any decides, since who decides may ask the others.
        views = [self._tell_mates(member, observation) for member in self._members]
        for member, view in zip(self._members, views, strict=True):
            member.sense(view)
        return np.stack(
            [member.drive(view, belief) for member, view, belief in zip(self._members, views, beliefs, strict=True)]
        )

    def assign(self, member: TeamRobot, survey: Survey, places: np.ndarray, frontiers: np.ndarray) -> int:
        """Return which of its open goals a robot gets when all robots without a point share out what there is.

        Args:
            member: the robot.
            survey: what it sees of the map.
            places: see `RrtExplorer`.
            frontiers: see `RrtExplorer`.

        Returns:
            Index into its goals; `NOBODY` for none.
        """
        others = [mate for mate in self._members if mate is not member and mate.target is None]
        asked = [(survey, places, frontiers)]
        asked += [mate.be_asked(self._beliefs[mate.index]) for mate in others if mate.makes_way_for is None]
        columns: dict[tuple[float, float], int] = {}
        for _, _, points in asked:
            for x, y in points.tolist():
                columns.setdefault((x, y), len(columns))
        costs = np.full((len(asked), len(columns)), np.inf)
        for row, (view, cells, points) in enumerate(asked):
            if view.field is not None and len(cells):
                costs[row, [columns[x, y] for x, y in points.tolist()]] = view.field.cost(cells)
        points = np.array(list(columns))
        taken = np.array([mate.target for mate in self._members if mate is not member and mate.target]).reshape(-1, 2)
        gaps = points[:, None] - taken
        costs[:, (np.hypot(gaps[..., 0], gaps[..., 1]) <= GOAL_RADIUS).any(axis=1)] = np.inf
        robots = np.array([view.pose[:2] for view, _, _ in asked])
        chosen = assign(survey.grid, robots, points, costs, self._params, taken)[0]
        if chosen == NOBODY:
            return NOBODY
        return int(np.flatnonzero((frontiers == points[chosen]).all(axis=1))[0])

    def _tell_mates(self, member: TeamRobot, observation: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Tell a robot where its mates are, and return what it observes without them."""
        robot, k = self._robot, member.index
        view = {key: observation[key][k] for key in ("scan", "motion")}
        mates = [mate for mate in self._members if mate is not member]
        if not mates:
            return view
        poses = [belief.pose for belief in self._beliefs]
        ranges = view["scan"] * np.float32(robot.lidar.range_max)
        obstacles: dict[bool, list[np.ndarray]] = {True: [NO_POINTS], False: [NO_POINTS]}
        for mate in mates:
            here = poses[mate.index]
            ahead = here.compose(
                Pose2D(float(observation["motion"][mate.index, 0]) * robot.max_v * LOOK_AHEAD, 0.0, 0.0)
            )
            obstacles[mate.precedence > member.precedence] += [
                outline(poses[k], here, robot.radius + MATE_GAP),
                outline(poses[k], ahead, robot.radius + MATE_GAP),
                self._without_mates.hits(ranges, poses[k], here),
            ]
        member.standing, member.passing = np.concatenate(obstacles[False]), np.concatenate(obstacles[True])
        is_hit = np.isnan(self._without_mates(ranges, poses[k], [poses[mate.index] for mate in mates]))
        return {**view, "scan": np.where(is_hit, np.float32(0.0), view["scan"])}

    def _clear_the_way(self, member: TeamRobot) -> None:
        """Find out which mate holds a robot up, and settle who lets whom pass."""
        gap = 2.0 * self._robot.radius + 0.1
        for mate in self._members:
            path = member.navigator.plan
            if mate is member or mate.makes_way_for is member or mate.precedence < member.precedence or path is None:
                continue
            if not is_beside(self._beliefs[mate.index].pose[:2], path, gap, BLOCKING_REACH):
                continue
            member.go_on()
            if mate.make_way(self._beliefs[mate.index], member):
                return
            if mate.navigator.plan is not None and member.make_way(self._beliefs[member.index], mate):
                return
            member.navigator.status = Status.FAILED
            return
