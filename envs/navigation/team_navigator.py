"""Drives the robots of a team that share a map, and settles who yields to whom.

Plans lead around peers of lower index, and through the others; `docs/team.md` says who has the right of way. Where a
peer that is to yield has nowhere to go, the robot yields to it; if neither can, the goal has failed. Peers are removed
from scans before these are remembered; their footprints replace them, which move with them and are known also where the
lidar is blind.

Each control period: `update` with the readings and beliefs, `choose` for the robots that it returns, and then `command`
of each robot.
"""

from collections.abc import Sequence

import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.estimation.peers import PeerFilter
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.navigation.candidates import Candidates
from lidarnaut.envs.navigation.obstacles import NO_POINTS
from lidarnaut.envs.navigation.team_robot import TeamRobot, is_beside, outline
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading

UNASSIGNED = -1
"""In place of a candidate, for a robot that gets none."""
OVERLAP = 2.0
"""Distance between frontiers from which on robots do not see the same there [m]."""
BLOCKING_REACH = 1.5
"""How far ahead on its path a robot is blocked by a peer [m]."""
PEER_CLEARANCE = 0.05
"""Distance that is kept to a peer besides that to other obstacles, since it moves [m]."""
PREDICTION_TIME = 0.5
"""A peer is an obstacle also where it will be after this time [s]."""


def discount(candidates: Candidates, frontier: Sequence[float] | np.ndarray, overlap: float = OVERLAP) -> None:
    """Take what another robot will see off the unknown area in view, in place.

    Up to `overlap` [m] from the `frontier` (x, y) that it goes to, area counts in proportion to the distance (after
    Burgard, Moors, Stachniss, Schneider, "Coordinated multi-robot exploration", 2005).
    """
    gaps = np.hypot(*(candidates["frontier"] - frontier).T)
    candidates["visible"][:] *= np.minimum(gaps / overlap, 1.0)


class TeamNavigator:
    """One or several robots, in the order of their indices."""

    def __init__(self, robot: RobotParams, team: Sequence[TeamRobot]) -> None:
        """Take robots of one kind."""
        self.team = team
        """The robots."""
        self._robot, self._peer_filter = robot, PeerFilter(robot)

    @property
    def end_reason(self) -> str | None:
        """Why the team has stopped exploring; None while any of its robots has not."""
        reasons = [robot.ended for robot in self.team]
        if None in reasons:
            return None
        return "no_reachable_frontier" if "no_reachable_frontier" in reasons else reasons[0]

    @property
    def plans(self) -> list[np.ndarray | None]:
        """The planned path of each robot for drawing, shape (n, 2), map frame [m]; None without one."""
        return [robot.plan for robot in self.team]

    @property
    def targets(self) -> list[tuple[float, float] | None]:
        """The frontier that each robot drives to (x, y), map frame [m]; None for a robot without one."""
        return [robot.driving_to for robot in self.team]

    def update(
        self, readings: Sequence[Reading], beliefs: Sequence[Belief], *, is_asked: bool = False
    ) -> list[TeamRobot]:
        """Let all robots process their readings, and return those that are to be assigned a frontier.

        Robots without one come last: they are asked as soon as any other robot is to be assigned one, or if `is_asked`.
        """
        self._poses, due = [belief.pose for belief in beliefs], list[TeamRobot]()
        for robot in self.team:
            if robot.is_blocked:
                self._resolve_conflict(robot)
        readings = [self._observe_peers(robot, reading) for robot, reading in zip(self.team, readings, strict=True)]
        for robot in sorted(self.team, key=lambda robot: robot.is_idle):
            for peer in self._peers_of(robot):
                robot.learn(beliefs[peer.index])
            if robot.advance(readings[robot.index], beliefs[robot.index], is_asked=is_asked or bool(due)):
                due.append(robot)
        return due

    def choose(self, due: Sequence[TeamRobot], choices: Sequence[int]) -> None:
        """Let robots drive to candidates of theirs; those that are `UNASSIGNED` wait for the others, or end."""
        for robot, index in zip(due, choices, strict=True):
            if index != UNASSIGNED:
                robot.choose(index)
        is_driving = any(target is not None for target in self.targets)
        for robot in due:
            if robot.driving_to is None:
                robot.wait() if is_driving else robot.look_around_or_end()

    def _peers_of(self, robot: TeamRobot) -> list[TeamRobot]:
        return [peer for peer in self.team if peer is not robot]

    def _observe_peers(self, robot: TeamRobot, reading: Reading) -> Reading:
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

    def _resolve_conflict(self, robot: TeamRobot) -> None:
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
