"""The explorers of Nguyen et al. (2022): random trees find frontiers, a filter clusters them, revenue assigns them.

Nguyen, Tran and Nguyen, "SLAM cho robot di động" (2022), after Umari and Mukhopadhyay, "Autonomous Robotic Exploration
Based on Multiple Rapidly-exploring Randomized Trees" (2017). Where the report leaves something open, its launch file
and the program behind it decide, with these exceptions:

- *The region.* That program has a person click the corners of the region to sample. Ours is the rectangle around
  everything observed and a margin.
- *Navigation cost.* The report asks for the path that the robot is expected to drive; the program takes the straight
  distance. We take the path, weighted by nearness to obstacles.
- *Invalid points.* The report drops points that no path leads to, the program those in costly cells; we do both. A
  point's goal is the frontier cell nearest to it, because the mean of points along a bend lies beside the frontier.
  What the robot could not see from the viewpoint that it took for it is no frontier any more.
- *The end.* The program never ends. Here exploration is over when the robot has turned once around, and the trees have
  grown for `patience` steps, without any point that could be assigned. Trees are random, so more may be left than by an
  explorer that lists all frontier cells.

The robot keeps its point until it is there, or the frontier around it is gone. Each robot of a team has a local tree;
all share a global tree, the filter and the assigner; `docs/team.md` says who has the right of way. Where a peer that is
to yield has nowhere to go, the robot yields to it; if neither can, the goal has failed. Peers are removed from scans
before these are remembered; their footprints replace them, which move with them and are known also where the lidar is
blind.
"""

import math
from collections.abc import Sequence

import numpy as np

from baselines.rrt.detector import TEAM_PARAMS, RrtDetector, RrtParams
from baselines.rrt.robot import RrtRobot, is_beside, outline
from envs.estimation import Belief
from envs.estimation.peers import PeerFilter
from envs.geometry import OccupancyGrid, Pose2D
from envs.navigation import NO_POINTS
from envs.navigation.frontiers import information_gain
from envs.robots import RobotParams
from envs.simulation import Reading, Twist

UNASSIGNED = -1
"""In place of a point, for a robot that gets none."""
BLOCKING_REACH = 1.5
"""How far ahead on its path a robot is blocked by a peer [m]."""
PEER_CLEARANCE = 0.05
"""Distance that is kept to a peer besides that to other obstacles, since it moves [m]."""
PREDICTION_TIME = 0.5
"""A peer is an obstacle also where it will be after this time [s]."""
SAME_POINT = 0.4
"""Points this near to one that another robot drives to are not assigned [m]."""


def assign(
    grid: OccupancyGrid,
    robots: np.ndarray,
    points: np.ndarray,
    costs: np.ndarray,
    params: RrtParams,
    taken: np.ndarray = NO_POINTS,
) -> np.ndarray:
    """Assign points by revenue (section 2.1.3): again and again the highest, until robots or points are used up.

    The revenue is R = lambda h(x_fp, x_r) I(x_fp) - N(x_fp), with lambda = `info_multiplier`, and h = `hysteresis_gain`
    within `hysteresis_radius` and 1 beyond, so that a robot finishes what is around it first. What a robot will see at
    its point is no gain for the others: unknown cells within `info_radius` of both points do not count any more.

    `robots` are positions x_r, shape (n, 2), `points` frontier points x_fp, shape (m, 2), `taken` points that other
    robots have already, shape (k, 2), all map frame [m]; `costs` are N, shape (n, m) [m], inf where there is no path.
    Returns the index of each robot's point, shape (n,), int64; `UNASSIGNED` where it can reach none that is left.
    """
    chosen = np.full(len(robots), UNASSIGNED, dtype=np.int64)
    gains = information_gain(grid, points, params.info_radius)
    for point in taken:
        gains = gains - information_gain(grid, points, params.info_radius, shared_with=point)
    gaps = robots[:, None] - points[None]
    is_near = np.hypot(gaps[..., 0], gaps[..., 1]) <= params.hysteresis_radius
    factors = params.info_multiplier * np.where(is_near, params.hysteresis_gain, 1.0)
    open_costs = costs.astype(np.float64)
    for _ in range(min(len(robots), len(points))):
        revenues = factors * gains - open_costs
        robot, point = np.unravel_index(np.argmax(revenues), revenues.shape)
        if math.isinf(revenues[robot, point]):
            break
        chosen[robot] = point
        gains = gains - information_gain(grid, points, params.info_radius, shared_with=points[point])
        open_costs[robot] = open_costs[:, point] = np.inf
    return chosen


class RrtTeam:
    """Explores with one or several robots."""

    is_team = True
    plan = None
    """Each robot has its own, see `plans`."""

    def __init__(self, params: RrtParams = TEAM_PARAMS) -> None:
        self._params = params
        self._team: list[RrtRobot] = []
        self._detector: RrtDetector | None = None

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode; see `baselines.explorer.Policy`."""
        self._robot, self._period = robot, control_period
        self._detector = RrtDetector(self._params, rng)
        self._team = []
        self._peer_filter = PeerFilter(robot)

    @property
    def end_reason(self) -> str | None:
        """Why the team has stopped exploring; None while any of its robots has not."""
        reasons = [robot.ended for robot in self._team]
        if None in reasons or not reasons:
            return None
        return "no_reachable_frontier" if "no_reachable_frontier" in reasons else reasons[0]

    @property
    def plans(self) -> list[np.ndarray | None]:
        """The planned path of each robot for drawing, shape (n, 2), map frame [m]; None without one."""
        return [robot.plan for robot in self._team]

    @property
    def points(self) -> np.ndarray:
        """Frontier points that have passed the filter, shape (n, 2), float64, map frame [m]."""
        return NO_POINTS if self._detector is None else self._detector.points

    @property
    def targets(self) -> list[tuple[float, float] | None]:
        """The frontier that each robot drives to (x, y), map frame [m]; None for a robot without one."""
        return [robot.driving_to for robot in self._team]

    def act(self, readings: Sequence[Reading], beliefs: Sequence[Belief]) -> list[Twist]:
        """Return the twist of each robot, from its reading and its belief; the map in these is one and the same.

        Raises a RuntimeError before the first `reset`.
        """
        if self._detector is None:
            raise RuntimeError("call reset before act")
        if not self._team:
            self._team = [RrtRobot(self._robot, self._period, self._params, k) for k in range(len(readings))]
        if self.end_reason is not None:
            return [Twist(0.0, 0.0) for _ in self._team]
        self._poses = [belief.pose for belief in beliefs]
        self._detector.detect(beliefs[0].grid, [pose[:2] for pose in self._poses])
        for robot in self._team:
            if robot.is_blocked:
                self._resolve_conflict(robot)
        readings = [self._observe_peers(robot, reading) for robot, reading in zip(self._team, readings, strict=True)]
        self._assign(self._update(readings, beliefs), beliefs)
        return [robot.command(belief) for robot, belief in zip(self._team, beliefs, strict=True)]

    def _update(self, readings: Sequence[Reading], beliefs: Sequence[Belief]) -> list[RrtRobot]:
        """Let all robots process their readings, and return those that are to be assigned a point.

        Robots without a point come last: they are asked as soon as any other robot is to be assigned one.
        """
        due: list[RrtRobot] = []
        for robot in sorted(self._team, key=lambda robot: robot.is_idle):
            for peer in self._peers_of(robot):
                robot.learn(beliefs[peer.index])
            robot.points = self.points
            if robot.advance(readings[robot.index], beliefs[robot.index], is_asked=bool(due)):
                due.append(robot)
        return due

    def _assign(self, due: list[RrtRobot], beliefs: Sequence[Belief]) -> None:
        """Assign points to robots that have none, all together (`assign`); those that get none wait, or end."""
        if not due:
            return
        columns: dict[tuple[float, float], int] = {}
        goals = [robot.open_goals() for robot in due]
        for frontiers, _, _ in goals:
            for x, y in frontiers.tolist():
                columns.setdefault((x, y), len(columns))
        costs = np.full((len(due), len(columns)), np.inf)
        for row, (frontiers, lengths, _) in enumerate(goals):
            costs[row, [columns[x, y] for x, y in frontiers.tolist()]] = lengths
        points = np.array(list(columns)).reshape(-1, 2)
        taken = np.array([robot.driving_to for robot in self._team if robot.driving_to]).reshape(-1, 2)
        gaps = points[:, None] - taken
        costs[:, (np.hypot(gaps[..., 0], gaps[..., 1]) <= SAME_POINT).any(axis=1)] = np.inf
        positions = np.array([self._poses[robot.index][:2] for robot in due]).reshape(-1, 2)
        chosen = assign(beliefs[0].grid, positions, points, costs, self._params, taken)
        for robot, (frontiers, _, indices), point in zip(due, goals, chosen, strict=True):
            if point != UNASSIGNED:
                robot.choose(int(indices[(frontiers == points[point]).all(axis=1).argmax()]))
        is_driving = any(robot.driving_to is not None for robot in self._team)
        for robot in due:
            if robot.driving_to is None:
                robot.wait() if is_driving else robot.look_around_or_end()

    def _peers_of(self, robot: RrtRobot) -> list[RrtRobot]:
        return [peer for peer in self._team if peer is not robot]

    def _observe_peers(self, robot: RrtRobot, reading: Reading) -> Reading:
        """Give a robot its peers as obstacles, and return its reading without them."""
        peers, pose, radius = self._peers_of(robot), self._poses[robot.index], self._robot.radius + PEER_CLEARANCE
        if not peers:
            return reading
        obstacles: dict[bool, list[np.ndarray]] = {True: [NO_POINTS], False: [NO_POINTS]}
        for peer in peers:
            here = self._poses[peer.index]
            ahead = here.compose(Pose2D(peer.navigator.velocity.v * PREDICTION_TIME, 0.0, 0.0))
            obstacles[peer.precedence > robot.precedence] += [
                outline(pose, here, radius),
                outline(pose, ahead, radius),
                self._peer_filter.hits(reading.ranges, pose, here),
            ]
        robot.bodies, robot.passing = np.concatenate(obstacles[False]), np.concatenate(obstacles[True])
        ranges = self._peer_filter(reading.ranges, pose, [self._poses[peer.index] for peer in peers])
        return reading._replace(ranges=ranges)

    def _resolve_conflict(self, robot: RrtRobot) -> None:
        """Find the peer that blocks a robot, and let one of them yield."""
        gap = 2.0 * self._robot.radius + 0.1
        for peer in self._peers_of(robot):
            path = robot.plan
            if peer.yielding_to is robot or peer.precedence < robot.precedence or path is None:
                continue
            if not is_beside(self._poses[peer.index][:2], path, gap, BLOCKING_REACH):
                continue
            robot.navigator.restart_progress()
            if not (peer.yield_to(robot, self._poses[peer.index]) or robot.yield_to(peer, self._poses[robot.index])):
                robot.fail()
            return


class RrtExplorer(RrtTeam):
    """Drives to the frontier point of the highest revenue that two random trees have found: a team of one robot."""

    is_team = False

    def __init__(self, params: RrtParams = RrtParams()) -> None:
        super().__init__(params)

    @property
    def plan(self) -> np.ndarray | None:  # type: ignore[override]
        """What is left of the planned path, shape (n, 2), map frame [m]; None without one."""
        return next(iter(self.plans), None)

    def act(self, reading: Reading, belief: Belief) -> Twist:  # type: ignore[override]
        """Return the twist; see `Explorer`."""
        return super().act([reading], [belief])[0]
