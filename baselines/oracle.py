"""The bound: an explorer that is told the truth, and drives a short tour from which enough of it is seen.

It plans on the true map and drives over the believed one, completed by the truth where that is unknown, with the
navigator of the other explorers: what distinguishes it from them is foresight.
"""

import math

import numpy as np

from baselines.cover_places import find_places
from baselines.cover_planner import CoverPlanner
from baselines.goal_explorer import DECISION_PERIOD
from baselines.navigator import Navigator, Status
from baselines.nearest import NearestExplorer
from baselines.senses import Senses
from baselines.survey import Survey
from baselines.true_map import TrueMap
from envs.navigation import plan_path
from envs.robots import RobotParams
from envs.simulation import Reading, Twist
from envs.slam import Belief
from envs.tasks.coverage import Coverage

FIRST_ROUNDS = 300
"""How long the first tour is looked for; see `search_tour`."""
ROUNDS = 4
"""How long a shorter one is looked for with each decision."""
LOOKAHEAD = 3.0
"""How far ahead along the tour paths are planned [m]; they end before if..."""
SHARP_TURN = 0.8
"""...they would turn more sharply than this at a stop [rad]."""
ARRIVED = 0.15
"""A stop this near has been reached [m]."""
REACH_MARGIN = 0.1
"""What is taken off the lidar's range in plans [m]."""
GOAL_TOLERANCE = 0.4
"""How far beside a stop a path may end where the map has something in the way [m]."""


class OracleExplorer:
    """Knows the place, and only has to drive through it. An `Omniscient`, served by `baselines.episode`."""

    def __init__(self) -> None:
        """Make an explorer; `reset` and then `reveal` prepare it for an episode."""
        self._rest = NearestExplorer()
        self._coverage: Coverage | None = None
        self._is_done = False

    @property
    def end_reason(self) -> str | None:
        """Why nothing is left that could be seen: that of `NearestExplorer`, which follows the tour; None before."""
        return self._rest.end_reason

    @property
    def plan(self) -> np.ndarray | None:
        """What is left of the planned path, shape (n, 2), map frame [m]; None without one."""
        return self._rest.plan if self._is_done or self._coverage is None else self._navigator.plan

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode; see `Explorer`."""
        self._robot = robot
        self._rng = rng
        self._navigator = Navigator(robot, control_period, rng)
        self._senses = Senses(robot, control_period)
        self._rest.reset(robot, control_period, rng)
        self._decision_steps = max(1, round(DECISION_PERIOD / control_period))
        self._countdown = 0
        self._coverage = None
        self._planner: CoverPlanner | None = None
        self._goal = -1
        self._is_done = False

    def reveal(self, coverage: Coverage, target_coverage: float) -> None:
        """Take the ground truth; see `Omniscient`."""
        self._start = coverage.start
        self._target_coverage = target_coverage
        self._coverage = coverage
        self._truth = TrueMap(coverage.area.walls, coverage.start)

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the twist; see `Explorer`.

        Raises:
            RuntimeError: the explorer has not been told the truth.
        """
        if self._coverage is None:
            raise RuntimeError("call reset and then reveal before act; run_episode does")
        observation = self._senses.observe(reading)
        if not self._is_done:
            self._navigator.sense(observation)
            self._countdown -= 1
            is_on_its_way = self._navigator.status is Status.DRIVING and self._countdown > 0
            if not (self._navigator.is_busy or is_on_its_way):
                self._countdown = self._decision_steps
                self._is_done = not self._decide(belief, self._coverage)
        if self._is_done:
            return self._senses.twist(self._rest._act(observation, belief))
        return self._senses.twist(self._navigator.act(observation, belief))

    def _decide(self, belief: Belief, coverage: Coverage) -> bool:
        """Plan what is left of the tour, and set out for its next stops; False if there are none."""
        num_rounds = ROUNDS
        if self._planner is None:
            self._planner = self._prepare(coverage)
            num_rounds = FIRST_ROUNDS
        planner, navigator = self._planner, self._navigator
        if planner is None:
            return False
        x, y, _ = self._start.compose(belief.pose)
        completed = Belief(belief.pose, self._truth.complete(belief.grid))
        surveys = [navigator.survey(completed, tightness) for tightness in range(navigator.max_tightness + 1)]
        if navigator.status is Status.FAILED and planner.stops:
            planner.leave_out(planner.stops[0])
        for place in np.flatnonzero(np.hypot(*(planner.places.points - (x, y)).T) < ARRIVED):
            planner.use_up(int(place), coverage.explored)
        while True:
            planner.plan(x, y, coverage.explored, num_rounds)
            num_rounds = ROUNDS
            if not planner.stops:
                return False
            stop = planner.stops[0]
            if navigator.status is Status.REACHED and self._goal == stop:
                planner.use_up(stop, coverage.explored)
            elif self._set_out(planner, surveys):
                return True
            else:
                planner.leave_out(stop)

    def _prepare(self, coverage: Coverage) -> CoverPlanner | None:
        """Spread places over the true map, for a smaller footprint if the whole one does not get around enough."""
        truth = Belief(self._start, coverage.area.walls)
        # The robot counts as having arrived a little before.
        reach, (x, y, _) = max(self._robot.lidar.range_max - REACH_MARGIN, 0.0), self._start
        first = None
        for tightness in range(self._navigator.max_tightness + 1):
            places = find_places(self._navigator.survey(truth, tightness).costmap, (x, y))
            if places is None:
                continue
            planner = CoverPlanner(coverage.area, places, reach, self._target_coverage, self._rng)
            if planner.plan(x, y, coverage.explored, 0):
                return planner
            first = first or planner
        return first

    def _set_out(self, planner: CoverPlanner, surveys: list[Survey]) -> bool:
        """Drive on along the tour; False if there is no way."""
        pose = self._start.compose(surveys[0].pose)
        places = planner.next_places(pose.x, pose.y, LOOKAHEAD)
        points = [(float(x), float(y)) for x, y in self._start.inverse().transform(planner.places.points[places])]
        for tightness, survey in enumerate(surveys):
            path = plan_path(survey.costmap, survey.pose[:2], points[0], tolerance=GOAL_TOLERANCE)
            if path is None:
                continue
            goal = places[0]
            for place, point in zip(places[1:], points[1:]):
                corner = float(path[-1, 0]), float(path[-1, 1])
                more = plan_path(survey.costmap, corner, point, tolerance=GOAL_TOLERANCE)
                if more is None or _turn(path, more) > SHARP_TURN:
                    break
                path = np.concatenate([path, more[1:]])
                goal = place
            if goal == self._goal and self._navigator.status is Status.DRIVING:
                # The clocks that tell when the robot is stuck go on.
                self._navigator.follow(path)
            else:
                self._navigator.drive_to((float(path[-1, 0]), float(path[-1, 1])), path, tightness=tightness)
            self._goal = goal
            return True
        return False


def _turn(path: np.ndarray, more: np.ndarray) -> float:
    """Return by how much a path turns where another one goes on from its end, from 0 to pi [rad]."""
    before = path[-1] - path[max(len(path) - 8, 0)]
    after = more[min(7, len(more) - 1)] - more[0]
    return abs(math.atan2(before[0] * after[1] - before[1] * after[0], before @ after))
