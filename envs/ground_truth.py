"""True course of a robot, and how far estimates are off from it. Never shown to what drives."""

from numba import njit

from envs.estimation.trail import Trail
from envs.geometry import Pose2D
from envs.geometry.pose import between, compose, distance
from envs.simulation import RobotState
from envs.simulation import state as at
from envs.simulation.rows import Rows


@njit(cache=True)
def pose_error(map_x, map_y, map_theta, x, y, theta, true_x, true_y, true_theta):
    """Return how far an estimated pose in the map frame is off: distance [m] and angle [rad], both at least 0."""
    world_pose = compose(map_x, map_y, map_theta, x, y, theta)
    dx, dy, turn = between(world_pose[0], world_pose[1], world_pose[2], true_x, true_y, true_theta)
    return distance(dx, dy), abs(turn)


class GroundTruth:
    """True course of a robot, for rewards, metrics and pictures: a view of its row, and its trail."""

    def __init__(self, rows: Rows, index: int) -> None:
        """Begin an episode at the state in a row."""
        self._rows, self._index = rows, index
        self.trail = Trail()
        """Positions so far, world frame."""
        self.remember()

    @property
    def state(self) -> RobotState:
        """Pose and velocity now."""
        return self._rows.state(self._index)

    @property
    def path_length(self) -> float:
        """Driven so far [m]."""
        return float(self._rows.numbers[self._index, at.PATH_LENGTH])

    def remember(self) -> None:
        """Append the position to the trail, if it is far enough from the last one."""
        x, y, theta = self._rows.numbers[self._index, at.X : at.THETA + 1].tolist()
        if self.trail.append(Pose2D(x, y, theta)):
            self._rows.numbers[self._index, at.TRUE_TRAIL : at.TRUE_TRAIL + 2] = self.trail.last

    def update(self) -> None:
        """Process a state to which something else than the kernels of a step has moved the robot."""
        row = self._rows.numbers[self._index]
        row[at.PATH_LENGTH] += distance(row[at.X] - row[at.LAST_X], row[at.Y] - row[at.LAST_Y])
        row[at.LAST_X : at.LAST_THETA + 1] = row[at.X : at.THETA + 1]
        self.remember()
