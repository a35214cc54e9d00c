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

from baselines.goal_explorer import GOAL_RADIUS, GoalExplorer
from baselines.navigator import NO_POINTS, Navigator, Status
from baselines.recovery import Dwell
from baselines.right_of_way import find_refuge, is_beside, outline
from baselines.rrt import RrtExplorer
from baselines.rrt_assigner import NOBODY, assign
from baselines.rrt_detector import RrtDetector, RrtParams
from baselines.survey import Survey
from envs.geometry import Pose2D
from envs.robots import RobotParams
from envs.slam import Belief
from envs.team import MateFilter

TEAM_PARAMS = RrtParams(eta_global=1.0)
"""The launch file of the published program for three robots."""
HOLD_TIME = 1.0
"""Time without getting anywhere after which a robot is held up [s]."""
BLOCKING_REACH = 1.5
"""How far ahead on a robot's path a mate holds it up [m]."""
PASSED_GAP = 0.5
"""Gap between the footprint of a robot that waits and the path of the one that passes, from which that one has [m]."""
MAX_WAIT = 15.0
"""Longest time to stand aside [s]."""
MATE_GAP = 0.05
"""Gap that is kept to a mate besides that to other obstacles, since it moves [m]."""
LOOK_AHEAD = 0.5
"""A mate is an obstacle also where it will be after this time [s]."""


class TeamMember(RrtExplorer):
    """One robot of the team. What it decides for itself is how to get to the point that the team assigns to it."""

    def __init__(self, params: RrtParams, team: "RrtTeam", index: int) -> None:
        """Make a robot of a team."""
        super().__init__(params)
        self._team = team
        self.index = index

    def join(self, robot: RobotParams, control_period: float, rng: np.random.Generator, detector: RrtDetector) -> None:
        """Prepare for a new episode with the team's detector."""
        self.reset(robot, control_period, rng)
        self._detector = detector
        self._held = Dwell(0.25 * robot.radius + 0.02, 0.3)
        self._held_time = 0.0
        self._pause = 0
        self._wait_time = 0.0
        self.makes_way_for: TeamMember | None = None
        self.standing, self.passing = NO_POINTS, NO_POINTS
        """Outlines of the mates that plans lead around, and of those that they lead through; base frame [m]."""

    @property
    def navigator(self) -> Navigator:
        """What drives it."""
        assert self._navigator is not None
        return self._navigator

    @property
    def target(self) -> tuple[float, float] | None:
        """The frontier that it is going to see (x, y), map frame [m]."""
        return None if self._goal is None else self._goal.frontier

    @property
    def precedence(self) -> tuple[bool, int]:
        """The lower goes first."""
        return self._goal is None, self.index

    @property
    def is_held_up(self) -> bool:
        """Whether it is on its way and does not get anywhere."""
        return self._held_time > HOLD_TIME and not self.navigator.is_busy and self.navigator.plan is not None

    def act(self, observation: dict[str, np.ndarray], belief: Belief) -> np.ndarray:
        """Return the action; see `Explorer`."""
        self._held_time = self._held.update(belief.pose) * self._period
        self._idle_steps += 1
        self._pause -= 1
        return GoalExplorer.act(self, observation, belief)

    def be_asked(self, belief: Belief) -> tuple[Survey, np.ndarray, np.ndarray]:
        """Return what it sees of the map, and what `_open_goals` says of that."""
        survey = self._survey(self.navigator, belief, self.navigator.tightness)
        return survey, *self._open_goals(survey)

    def make_way(self, belief: Belief, other: "TeamMember") -> bool:
        """Drive off the path of another robot, and give the own point up; False if there is nowhere to go."""
        path = other.navigator.plan
        survey = self.navigator.survey(belief)
        cell = None if path is None else find_refuge(survey, path, self._robot.radius)
        if cell is None:
            return False
        assert survey.field is not None
        way = survey.field.path(*cell)
        assert way is not None
        x, y = survey.grid.centers(np.array(cell))
        self.navigator.drive_to((float(x), float(y)), way)
        self._goal, self.makes_way_for, self._wait_time = None, other, 0.0
        return True

    def go_on(self) -> None:
        """Forget that it was held up."""
        self._held.restart()
        self._held_time = 0.0

    def revive(self) -> None:
        """Go on, since there is still something to explore."""
        self._end_reason = None
        self._idle_steps = 0

    def _sense(self, navigator: Navigator, observation: dict[str, np.ndarray]) -> None:
        navigator.sense(observation, self.standing, self.passing)

    def _consider(self, navigator: Navigator, belief: Belief) -> None:
        if self.makes_way_for is not None:
            if not self._has_passed(self.makes_way_for, belief):
                return
            self.makes_way_for = None
            navigator.wait()
        if self._pause > 0 and self._goal is None:
            return
        super()._consider(navigator, belief)
        if self._goal is None and self._team.is_exploring:
            # Nothing is left for this one as things stand: no reason to turn around, or to look again at every step.
            navigator.wait()
            self._end_reason, self._has_looked_around, self._pause = None, False, self._decision_steps

    def _has_passed(self, other: "TeamMember", belief: Belief) -> bool:
        path = other.navigator.plan
        if path is None:
            return True
        if self.navigator.status is Status.DRIVING:
            return False
        self._wait_time += self._period
        is_off = not is_beside(belief.pose[:2], path, 2.0 * self._robot.radius + PASSED_GAP)
        return is_off or self._wait_time > MAX_WAIT

    def _assigned(self, survey: Survey, places: np.ndarray, frontiers: np.ndarray) -> int:
        return self._team.assign(self, survey, places, frontiers)


class RrtTeam:
    """Explores with several robots."""

    def __init__(self, params: RrtParams = TEAM_PARAMS) -> None:
        """Make a team with the given parameters."""
        self._params = params
        self._members: list[TeamMember] = []

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
        self._members = [TeamMember(self._params, self, k) for k in range(num_robots)]
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

    @property
    def is_exploring(self) -> bool:
        """Whether any robot is on its way to a point."""
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
        actions = np.empty((len(self._members), 2), dtype=np.float32)
        for member in self._members:
            view = self._tell_mates(member, observation)
            actions[member.index] = member.act(view, beliefs[member.index])
        return actions

    def assign(self, member: TeamMember, survey: Survey, places: np.ndarray, frontiers: np.ndarray) -> int:
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
        params = self._params
        chosen = assign(
            survey.grid,
            np.array([view.pose[:2] for view, _, _ in asked]),
            points,
            costs,
            info_radius=params.info_radius,
            info_multiplier=params.info_multiplier,
            hysteresis_radius=params.hysteresis_radius,
            hysteresis_gain=params.hysteresis_gain,
            taken=taken,
        )[0]
        if chosen == NOBODY:
            return NOBODY
        return int(np.flatnonzero((frontiers == points[chosen]).all(axis=1))[0])

    def _tell_mates(self, member: TeamMember, observation: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
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

    def _clear_the_way(self, member: TeamMember) -> None:
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
