"""Kinematic physics: rolling wheels with slip, and circular footprints that slide along obstacles."""

import math
from collections.abc import Sequence

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.worlds import World

from .contact import push_out, select_near
from .crowd import person_row as crowd_at
from .crowd.step import step_people, with_people
from .mover import Simulator
from .records import TOUCHED_PERSON, unpack_robot
from .sensors import SLIP_LEFT, SLIP_RIGHT, sense, with_peers

SLIP_MARGIN = 0.5
"""Wheel slip raises speed and yaw rate above the robot's maxima by at most this fraction."""
_MAX_SLIDE_RATIO = 1.1
"""Maximum displacement of a robot pushed out of an obstacle in a physics step, divided by its displacement without the
obstacle. Beyond this and half its radius, the robot stays in place."""


@njit(cache=True, error_model="numpy")
def plan_wheels(reached, command, normals, robot, rates, slips):
    """Compute the wheel rates that bring a robot to a commanded twist, within its limits, for one control period.

    Returns the twist (v, w) at the end, without slip. `reached`: twist at the start [m/s, rad/s]. `normals`: a standard
    normal number per wheel. `rates`, `slips`: outputs, shape (substeps, 2), float64 [rad/s]: wheel rates without slip,
    and random slip (Siegwart and Nourbakhsh, Introduction to Autonomous Mobile Robots, equation 5.8).
    """
    v, w = reached
    substeps = int(robot.substeps)
    dt = robot.period / substeps
    target_v = min(max(command[0], -robot.max_v), robot.max_v)
    target_w = min(max(command[1], -robot.max_w), robot.max_w)
    change_v, change_w = robot.max_acc_v * dt, robot.max_acc_w * dt
    most_forward = (1.0 + SLIP_MARGIN) * robot.max_v / robot.assumed_wheel_radius
    most_turn = (1.0 + SLIP_MARGIN) * 0.5 * robot.max_w * robot.assumed_track / robot.assumed_wheel_radius
    for i in range(substeps):
        v += min(max(target_v - v, -change_v), change_v)
        w += min(max(target_w - w, -change_w), change_w)
        rates[i, 0] = (v - 0.5 * w * robot.assumed_track) / robot.assumed_wheel_radius
        rates[i, 1] = (v + 0.5 * w * robot.assumed_track) / robot.assumed_wheel_radius
        for wheel in range(2):
            rolled = abs(rates[i, wheel]) * dt * robot.wheel_radius
            slipped = robot.slip_std * math.sqrt(rolled / substeps) * normals[wheel]
            slips[i, wheel] = slipped / (robot.wheel_radius * dt)
        left, right = rates[i, 0] + slips[i, 0], rates[i, 1] + slips[i, 1]
        forward, turn = 0.5 * (left + right), 0.5 * (right - left)
        forward -= min(max(forward, -most_forward), most_forward)  # zero except for extreme slip
        turn -= min(max(turn, -most_turn), most_turn)
        slips[i, 0] -= forward - turn
        slips[i, 1] -= forward + turn
    return v, w


@njit(cache=True, error_model="numpy")
def advance(state, command, normals, robot, segments, circles):
    """Move a robot by one control period. The footprint slides along obstacles.

    `state`: record, updated. `command`: twist (v, w) [m/s, rad/s]. `normals`: random numbers for wheel slip.
    `segments`, `circles`: obstacles, shapes (n, 4) and (m, 3), float64 [m].

    Returns:
        Whether the footprint touched anything, and which circles were touched: shape (m,), bool.
    """
    substeps = int(robot.substeps)
    dt = robot.period / substeps
    fastest = robot.max_v * robot.wheel_radius / robot.assumed_wheel_radius
    near = np.empty(segments.shape[0] + 1, dtype=np.int64)
    ahead, near_x, near_y = fastest * robot.period, state.x, state.y
    num_near = select_near(near_x, near_y, 2.0 * (robot.radius + ahead), segments, near)
    hits = np.zeros(circles.shape[0], dtype=np.bool_)
    rates, slips = np.empty((substeps, 2)), np.empty((substeps, 2))
    reached = (state.commanded_v, state.commanded_w)
    state.commanded_v, state.commanded_w = plan_wheels(reached, command, normals, robot, rates, slips)
    touched = False
    turned = 0.0
    for step in range(substeps):
        left = (rates[step, 0] + slips[step, 0]) * robot.wheel_radius * dt
        right = (rates[step, 1] + slips[step, 1]) * robot.wheel_radius * dt
        turn = (right - left) / robot.track
        half = 0.5 * turn
        chord = 0.5 * (left + right) * (math.sin(half) / half if half != 0.0 else 1.0)
        x, y, theta = state.x, state.y, state.theta
        if (x - near_x) ** 2 + (y - near_y) ** 2 > ahead * ahead:
            num_near, near_x, near_y = select_near(x, y, 2.0 * (robot.radius + ahead), segments, near), x, y
        c, s = math.cos(theta + half), math.sin(theta + half)
        new_x, new_y, contact, free = push_out(
            x + chord * c, y + chord * s, robot.radius, segments, near, num_near, circles, hits
        )
        touched |= contact
        if contact:  # prevents tunnelling
            limit = max(_MAX_SLIDE_RATIO * abs(chord), 0.5 * robot.radius)
            if not free or math.hypot(new_x - x, new_y - y) > limit:
                new_x, new_y = x, y
        state.x, state.y, state.theta = new_x, new_y, wrap_angle(theta + turn)
        turned += turn
        state.left_angle += rates[step, 0] * dt
        state.right_angle += rates[step, 1] * dt
        state.v, state.w = ((new_x - x) * c + (new_y - y) * s) / dt, turn / dt
    state.mean_w = turned / robot.period
    return touched, hits


@njit(cache=True, error_model="numpy")
def step_robots(rows, draws, ranges, segments, circles, magnets, crowd):
    """Move people and robots of a world by one control period, and simulate the sensors.

    People move first and stop at robots. Robots move one after another. `rows`: records, updated. `ranges`:
    output, lidar ranges [m]. `segments`, `circles`: obstacles, shapes (n, 4) and (m, 3), float64 [m]. `magnets`:
    `World.magnets`. `crowd`: `People.arrays`, or None without people.
    """
    robot, num_circles = unpack_robot(rows[0]), circles.shape[0]
    radius = robot.radius
    for k in range(rows.shape[0]):
        rows[k].touched = 0.0
        rows[k].steps += 1.0
        rows[k].time = rows[k].steps * robot.period
        rows[k].draw += 1.0
    if crowd is not None and crowd[0].shape[0] > 0:
        step_people(crowd[0], crowd[1], crowd[2], crowd[3], rows)
    bodies = circles if crowd is None else with_people(circles, crowd[0], 0.0)
    num_fixed = bodies.shape[0]
    for k in range(rows.shape[0]):
        row = rows[k]
        noise = draws[k, int(row.draw)]
        command, slip = (row.command[0], row.command[1]), (noise[SLIP_LEFT], noise[SLIP_RIGHT])
        touched, hits = advance(row, command, slip, robot, segments, with_peers(bodies, rows, k, radius))
        row.touched = max(row.touched, 1.0 if touched else 0.0)
        for j in range(num_circles, hits.shape[0]):
            if hits[j] and j < num_fixed:
                row.touched = TOUCHED_PERSON + j - num_circles
            elif hits[j]:  # contact is mutual
                peer = j - num_fixed + (j - num_fixed >= k)
                rows[peer].touched = max(rows[peer].touched, 1.0)
    seen = circles if crowd is None else with_people(circles, crowd[0], crowd[3][crowd_at.LEGS])
    sense(rows, draws, ranges, segments, seen, magnets)


class KinematicSimulator(Simulator):
    """Simulator that computes robot motion from wheel rates, without forces."""

    ignored = ("body.friction", "body.mass", "drive.friction", "drive.max_torque")

    def _place(self, world: World, poses: Sequence[Pose2D]) -> None:
        for row, pose in zip(self.rows.numbers, poses, strict=True):
            row["x"], row["y"], row["theta"] = pose.x, pose.y, wrap_angle(pose.theta)

    def _move(self, world: World) -> None:
        rows, crowd = self.rows, self.crowd.arrays if len(self.crowd.rows) else None
        step_robots(rows.numbers, rows.draws, rows.ranges, world.segments, world.circles, world.magnets, crowd)
