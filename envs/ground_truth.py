"""True course of a robot, and how far estimates are off from it. Never shown to what drives."""

from numba import njit

from envs.estimation.trail import Trail
from envs.geometry.pose import between, compose, distance
from envs.simulation import RobotState


@njit(cache=True)
def pose_error(map_x, map_y, map_theta, x, y, theta, true_x, true_y, true_theta):
    """Return how far an estimated pose in the map frame is off: distance [m] and angle [rad], both at least 0."""
    world_pose = compose(map_x, map_y, map_theta, x, y, theta)
    dx, dy, turn = between(world_pose[0], world_pose[1], world_pose[2], true_x, true_y, true_theta)
    return distance(dx, dy), abs(turn)


class GroundTruth:
    """True course of a robot, for rewards, metrics and pictures."""

    def __init__(self, state: RobotState) -> None:
        """Begin an episode at a state."""
        self.state = state
        self.trail = Trail()
        """Positions so far, world frame."""
        self.path_length = 0.0
        """Driven so far [m]."""
        self.trail.append(state.pose)

    def update(self, state: RobotState) -> None:
        """Process the state at the end of a control period."""
        before, self.state = self.state.pose, state
        self.path_length += distance(state.pose.x - before.x, state.pose.y - before.y)
        self.trail.append(state.pose)
