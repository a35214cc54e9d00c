"""The explorer of Nguyen et al. (2022) for several robots with one map.

Each robot has a local tree; all share a global tree, the filter and the assigner. After Umari and Mukhopadhyay,
"Autonomous Robotic Exploration Based on Multiple Rapidly-exploring Randomized Trees" (2017), who ran it on two and
three robots. What `baselines.rrt.explorer` says of one robot holds for each; besides:

- *Assignment.* Points are assigned whenever a robot has none: to all robots without one together. The others keep
  theirs, and what those will see there is no gain any more. A robot for which no point is left waits.
- *Right of way.* A robot's plans lead around peers of lower index, and through those of higher index or without a
  point: these yield. A robot blocked by such a peer makes it drive off its path, and wait there until it has passed.
  Where the peer has nowhere to go, the robot yields to it; if neither can, the goal has failed.
- *Peers as obstacles.* Robots tell each other their estimated poses. Peers are removed from scans before these are
  remembered; their footprints take their place, which move with them and are known also where the lidar is blind.
"""

import numpy as np

from baselines.goal_explorer import GOAL_RADIUS
from baselines.navigator import NO_POINTS, Status
from baselines.rrt.assigner import NOBODY, assign
from baselines.rrt.detector import RrtDetector
from baselines.rrt.goals import OpenGoals
from baselines.rrt.params import TEAM_PARAMS, RrtParams
from baselines.rrt.right_of_way import is_beside, outline
from baselines.rrt.team_robot import TeamRobot
from baselines.survey import Survey
from envs.estimation.peers import PeerFilter
from envs.geometry import Pose2D
from envs.robots import RobotParams
from envs.slam import Belief

BLOCKING_REACH = 1.5
"""How far ahead on its path a robot is blocked by a peer [m]."""
PEER_CLEARANCE = 0.05
"""Distance that is kept to a peer besides that to other obstacles, since it moves [m]."""
PREDICTION_TIME = 0.5
"""A peer is an obstacle also where it will be after this time [s]."""


class RrtTeam:
    """Explores with several robots."""

    def __init__(self, params: RrtParams = TEAM_PARAMS) -> None:
        """Make a team with the given parameters."""
        self._params = params
        self._team: list[TeamRobot] = []

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
        self._team = [TeamRobot(self._params, k, self.assign, self._is_anyone_driving) for k in range(num_robots)]
        for teammate in self._team:
            teammate.join(robot, control_period, rng, self._detector)
        self._peer_filter = PeerFilter(robot)

    @property
    def end_reason(self) -> str | None:
        """Why the team has stopped exploring; None while any of its robots has not."""
        reasons = [robot.end_reason for robot in self._team]
        if None in reasons or not reasons:
            return None
        return "no_reachable_frontier" if "no_reachable_frontier" in reasons else reasons[0]

    def _is_anyone_driving(self) -> bool:
        return any(robot.target is not None for robot in self._team)

    @property
    def plans(self) -> list[np.ndarray | None]:
        """The planned path of each robot for drawing, shape (n, 2), map frame [m]; None without one."""
        return [robot.plan for robot in self._team]

    @property
    def points(self) -> np.ndarray:
        """Frontier points that have passed the filter, shape (n, 2), float64, map frame [m]."""
        return self._detector.points

    @property
    def targets(self) -> list[tuple[float, float] | None]:
        """The frontier point of each robot (x, y), map frame [m]; None for a robot without one."""
        return [robot.target for robot in self._team]

    def act(self, observation: dict[str, np.ndarray], beliefs: list[Belief]) -> np.ndarray:
        """Return the actions.

        Args:
            observation: of `ExploreTeamEnv`.
            beliefs: pose estimate of each robot; the map in them is one and the same.

        Returns:
            Shape (num_robots, 2), float32.
        """
        if not self._team:
            raise RuntimeError("call reset before act")
        if self.end_reason is not None:
            return np.zeros((len(self._team), 2), dtype=np.float32)
        self._beliefs = beliefs
        self._detector.detect(beliefs[0].grid, [belief.pose[:2] for belief in beliefs])
        for robot in self._team:
            if any(peer.target is not None for peer in self._peers_of(robot)):
                robot.resume()
            if robot.is_blocked:
                self._resolve_conflict(robot)
        # All process their readings before any decides, since the one that decides asks the others for their goals.
        views = [self._observe_peers(robot, observation) for robot in self._team]
        for robot, view in zip(self._team, views, strict=True):
            robot.sense(view)
        return np.stack(
            [robot.drive(view, belief) for robot, view, belief in zip(self._team, views, beliefs, strict=True)]
        )

    def assign(self, robot: TeamRobot, survey: Survey, goals: OpenGoals) -> int:
        """Return which of its open goals a robot gets when all robots without a point are assigned one.

        Args:
            robot: the robot.
            survey: its view of the map.
            goals: its open goals.

        Returns:
            Index into its goals; `NOBODY` for none.
        """
        peers = self._peers_of(robot)
        asked = [(survey, goals)]
        for peer in peers:
            if peer.target is None and peer.yielding_to is None:
                asked.append(peer.open_goals(self._beliefs[peer.index]))
        columns: dict[tuple[float, float], int] = {}
        for _, theirs in asked:
            for x, y in theirs.frontiers.tolist():
                columns.setdefault((x, y), len(columns))
        costs = np.full((len(asked), len(columns)), np.inf)
        for row, (view, theirs) in enumerate(asked):
            if view.field is not None and len(theirs.viewpoints):
                costs[row, [columns[x, y] for x, y in theirs.frontiers.tolist()]] = view.field.cost(theirs.viewpoints)
        points = np.array(list(columns))
        taken = np.array([peer.target for peer in peers if peer.target]).reshape(-1, 2)
        gaps = points[:, None] - taken
        costs[:, (np.hypot(gaps[..., 0], gaps[..., 1]) <= GOAL_RADIUS).any(axis=1)] = np.inf
        positions = np.array([view.pose[:2] for view, _ in asked])
        chosen = assign(survey.grid, positions, points, costs, self._params, taken)[0]
        if chosen == NOBODY:
            return NOBODY
        return int(np.flatnonzero((goals.frontiers == points[chosen]).all(axis=1))[0])

    def _peers_of(self, robot: TeamRobot) -> list[TeamRobot]:
        return [peer for peer in self._team if peer is not robot]

    def _observe_peers(self, robot: TeamRobot, observation: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Give a robot its peers as obstacles, and return its observation without them."""
        params, k, peers = self._robot, robot.index, self._peers_of(robot)
        view = {key: observation[key][k] for key in ("scan", "motion")}
        if not peers:
            return view
        poses = [belief.pose for belief in self._beliefs]
        ranges = view["scan"] * np.float32(params.lidar.range_max)
        obstacles: dict[bool, list[np.ndarray]] = {True: [NO_POINTS], False: [NO_POINTS]}
        for peer in peers:
            here, speed = poses[peer.index], float(observation["motion"][peer.index, 0]) * params.max_v
            ahead = here.compose(Pose2D(speed * PREDICTION_TIME, 0.0, 0.0))
            obstacles[peer.precedence > robot.precedence] += [
                outline(poses[k], here, params.radius + PEER_CLEARANCE),
                outline(poses[k], ahead, params.radius + PEER_CLEARANCE),
                self._peer_filter.hits(ranges, poses[k], here),
            ]
        robot.standing, robot.passing = np.concatenate(obstacles[False]), np.concatenate(obstacles[True])
        is_hit = np.isnan(self._peer_filter(ranges, poses[k], [poses[peer.index] for peer in peers]))
        return {**view, "scan": np.where(is_hit, np.float32(0.0), view["scan"])}

    def _resolve_conflict(self, robot: TeamRobot) -> None:
        """Find the peer that blocks a robot, and let one of them yield."""
        gap = 2.0 * self._robot.radius + 0.1
        for peer in self._peers_of(robot):
            path = robot.navigator.plan
            if peer.yielding_to is robot or peer.precedence < robot.precedence or path is None:
                continue
            if not is_beside(self._beliefs[peer.index].pose[:2], path, gap, BLOCKING_REACH):
                continue
            robot.reset_progress()
            if peer.yield_to(self._beliefs[peer.index], robot):
                return
            if peer.navigator.plan is not None and robot.yield_to(self._beliefs[robot.index], peer):
                return
            robot.navigator.status = Status.FAILED
            return
