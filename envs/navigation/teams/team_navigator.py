"""Navigation of robot teams on a shared map, with rights of way.

Planned paths avoid teammates with the right of way. Other teammates yield if they can; see `docs/concepts/team.md`.
Current and predicted footprints of teammates replace scanned points on them.
"""

from collections.abc import Sequence

import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.estimation.scan_points import BODY_MARGIN, ScanGeometry, are_on_bodies, as_bodies, scan_ends
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.navigation.frontiers.candidates import Candidates
from lidarnaut.envs.navigation.maps.obstacles import NO_POINTS
from lidarnaut.envs.navigation.teams.team_robot import TeamRobot, is_beside, outline
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading

UNASSIGNED = -1
"""Candidate index of a robot without an assigned frontier."""
OVERLAP = 2.0
"""Distance between frontiers below which the views of two robots overlap [m]."""
BLOCKING_REACH = 1.5
"""Length of the path ahead on which another robot counts as blocking [m]."""
PEER_CLEARANCE = 0.05
"""Additional clearance to peers, because peers move [m]."""
PREDICTION_TIME = 0.5


def discount(candidates: Candidates, frontier: Sequence[float] | np.ndarray) -> None:
    """Reduce the unknown area in view (`visible`) of candidates near another robot's frontier, in place.

    Within `OVERLAP` of `frontier` (x, y), map frame, area is multiplied by distance divided by `OVERLAP` (after
    Burgard, Moors, Stachniss, Schneider, "Coordinated multi-robot exploration", 2005).
    """
    candidates["visible"][:] *= np.minimum(np.hypot(*(candidates["frontier"] - frontier).T) / OVERLAP, 1.0)


class TeamNavigator:
    """Navigates one or several robots that explore a shared map.

    Each control period, call `update`, `choose` for the returned robots, then `command` of each robot.
    """

    def __init__(self, robot: RobotParams, team: Sequence[TeamRobot]) -> None:
        self.team = team
        self._robot, self._geometry = robot, ScanGeometry.of(robot.lidar)

    @property
    def end_reason(self) -> str | None:
        """Reason why the team stopped exploring; None while exploring."""
        reasons = [robot.ended for robot in self.team]
        if None in reasons:
            return None
        return "no_reachable_frontier" if "no_reachable_frontier" in reasons else reasons[0]

    @property
    def plans(self) -> list[np.ndarray | None]:
        """Remaining path of each robot, shape (n, 2), map frame [m]; None without a path."""
        return [robot.plan for robot in self.team]

    @property
    def targets(self) -> list[tuple[float, float] | None]:
        """Frontier that each robot drives to (x, y), map frame [m]; None without a frontier."""
        return [robot.driving_to for robot in self.team]

    def update(
        self, readings: Sequence[Reading], beliefs: Sequence[Belief], *, is_asked: bool = False
    ) -> list[TeamRobot]:
        """Process a sensor reading of each robot; return the robots that need a new frontier.

        A robot that waits for a frontier is included if another robot needs one, or if `is_asked`.
        """
        self._poses, due = [belief.pose for belief in beliefs], list[TeamRobot]()
        for robot in self.team:
            if robot.is_blocked:
                self._resolve_conflict(robot)
        readings = [self._observe_peers(robot, reading) for robot, reading in zip(self.team, readings, strict=True)]
        for robot in sorted(self.team, key=lambda robot: robot.is_idle):
            if robot.candidates is not None:  # after `begin`
                for peer in self._peers_of(robot):
                    robot.integrate(beliefs[peer.index])
            if robot.advance(readings[robot.index], beliefs[robot.index], is_asked=is_asked or bool(due)):
                due.append(robot)
        return due

    def choose(self, due: Sequence[TeamRobot], choices: Sequence[int]) -> None:
        """Begin drives to the chosen candidates (reachable frontiers).

        Robots with `UNASSIGNED` in `choices` wait, look around or stop exploring.
        """
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
        peers, pose, radius = self._peers_of(robot), self._poses[robot.index], self._robot.radius + PEER_CLEARANCE
        if not peers:
            return reading
        obstacles: dict[bool, list[np.ndarray]] = {True: [NO_POINTS], False: [NO_POINTS]}
        places = [self._poses[peer.index] for peer in peers]
        bodies, ends = as_bodies(pose, places, self._robot.radius), scan_ends(reading.ranges, self._geometry)
        for peer, here, body in zip(peers, places, bodies, strict=True):
            ahead = here.compose(Pose2D(peer.navigator.velocity.v * PREDICTION_TIME, 0.0, 0.0))
            points = [outline(pose, place, radius) for place in (here, ahead)]
            points.append(ends[are_on_bodies(ends, body[None], BODY_MARGIN)])
            obstacles[peer.precedence > robot.precedence] += points
        robot.bodies, robot.passing = np.concatenate(obstacles[False]), np.concatenate(obstacles[True])
        is_on = are_on_bodies(ends, bodies, BODY_MARGIN)
        return reading._replace(ranges=np.where(is_on, np.float32(np.nan), reading.ranges))

    def _resolve_conflict(self, robot: TeamRobot) -> None:
        gap = 2.0 * self._robot.radius + 0.1
        for peer in self._peers_of(robot):
            path = robot.plan
            if peer.yielding_to is robot or peer.precedence < robot.precedence or path is None:
                continue
            if not is_beside(self._poses[peer.index][:2], path, gap, BLOCKING_REACH):
                continue
            robot.navigator.record["stall_steps"] = -1
            if not (peer.yield_to(robot, self._poses[peer.index]) or robot.yield_to(peer, self._poses[robot.index])):
                robot.fail()
            return
