"""One robot: its readings, its estimates of pose and map, and the path that it took."""

from envs.estimation import ORIGIN, Belief, Estimator
from envs.estimation.belief import check_belief
from envs.estimation.map_pyramid import MapPyramid
from envs.estimation.motion import MotionSource
from envs.estimation.peers import PeerFilter
from envs.estimation.trail import Trail, interpolate
from envs.robots import RobotParams
from envs.simulation import Reading, Twist


class Robot:
    """A robot with its sensors, odometry and estimator. Holds no ground truth.

    What `ground_truth` tells it of its motion, where users ask for `slam="truth"`, reaches the estimator alone.
    """

    def __init__(
        self,
        params: RobotParams,
        control_period: float,
        estimator: Estimator,
        odometry: MotionSource,
        ground_truth: MotionSource | None = None,
    ) -> None:
        """Assemble a robot.

        Args:
            params: the robot.
            control_period: time between two readings [s].
            estimator: turns scans and motions into a belief.
            odometry: motion by the robot's own sensors.
            ground_truth: motion that the estimator gets instead; None for odometry.
        """
        self.params = params
        self.estimator = estimator
        kind = type(estimator)  # checks of the project's own would take a twentieth of a kinematic step
        self._own_estimator = "" if kind.__module__.startswith("envs.") else kind.__name__
        self.odometry = odometry
        self.ground_truth = ground_truth
        self.control_period = control_period
        """Time between two readings [s]."""
        self.peers: list[Robot] = []
        """The other robots of a team, which tell this one their poses."""
        self._peer_filter = PeerFilter(params)

    @property
    def belief(self) -> Belief:
        """Pose estimate and map."""
        return self.estimator.belief

    def start(self, reading: Reading) -> None:
        """Begin an episode at rest, once the estimator has been reset; `locate` processes the reading's scan."""
        self.reading = reading
        self.twist = Twist(0.0, 0.0)
        """Velocity by odometry."""
        self.action = (0.0, 0.0)
        """The last action: forward speed and yaw rate over their limits."""
        self.collisions = 0
        """Contacts so far."""
        self.motion = ORIGIN
        """Motion of the base during the last period, as the estimator learns of it."""
        self.predicted_pose = self.belief.pose
        """Pose estimate before the last scan was processed, and with it once it is."""
        self.odometry.reset(reading)
        if self.ground_truth is not None:
            self.ground_truth.reset(reading)
        self.trail = Trail()
        """Estimated positions so far, map frame."""
        self.pyramid = MapPyramid(self.belief.grid, [self.trail])
        """The map at the scales of observations."""
        self._data = self.belief.grid.data, self.belief.grid.data.shape

    def sense(self, reading: Reading) -> None:
        """Process a reading but for its scan: odometry and bumper."""
        self.collisions += reading.bumper and not self.reading.bumper
        self.reading = reading
        motion = self.odometry.update(reading)
        self.twist = Twist(motion.x / self.control_period, motion.theta / self.control_period)
        self.motion = motion if self.ground_truth is None else self.ground_truth.update(reading)
        if self.peers:
            self.predicted_pose = self.belief.pose.compose(self.motion)

    def locate(self) -> None:
        """Process the reading's scan: pose, map and trail.

        Raises:
            ValueError: no map can be made of the belief; see `check_belief`.
        """
        ranges = self.reading.ranges
        if self.peers:
            peers = [peer.predicted_pose for peer in self.peers]
            ranges = self._peer_filter(ranges, self.predicted_pose, peers)
        belief = self.estimator.update(ranges, self.motion)
        if self._own_estimator:
            check_belief(belief, self._own_estimator, self.pyramid.grid, self._data)
            self._data = belief.grid.data, belief.grid.data.shape
        self.follow(belief)

    def follow(self, belief: Belief) -> None:
        """Bring trail and pyramid up to date with the belief after a scan."""
        self.predicted_pose = belief.pose
        if belief.update.redrawn and belief.path is not None:
            self.trail.replace(interpolate(belief.path[:, :2]))
        self.pyramid.update(belief.update)
        if self.trail.append(belief.pose):
            self.pyramid.mark(belief.pose.x, belief.pose.y)
