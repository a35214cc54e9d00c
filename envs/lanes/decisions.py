"""The drive of `ExploreFrontiersEnv` as a kernel: one lane until its pilot has something to say."""

from typing import NamedTuple

import numpy as np
from numba import njit

from envs.frontier_choice.choice import OVER
from envs.frontier_choice.pilot import act, judge, sense
from envs.frontier_choice.records import DRIVING
from envs.lanes.kernels import array_at, draw, drive, has_room, locate, mark_trail, measure_error

ROOM, STEPPED = -3, -4
"""What `drive_on` says beside the pilot: map or trail lack room; a step is made in a lane where things move."""


class Pilots(NamedTuple):
    """The arrays of one lane's `FrontierChoice`."""

    pilot: np.ndarray
    path: np.ndarray
    obstacles: np.ndarray
    given_up: np.ndarray


class Tallies(NamedTuple):
    """What is counted of all lanes, one row per lane."""

    num_seen: np.ndarray
    """Shape (n,), int64: explorable cells that are truly known."""
    num_explorable: np.ndarray
    """Shape (n,), int64."""
    steps: np.ndarray
    """Shape (n,), int64: control steps of the decision."""
    touches: np.ndarray
    """Shape (n,), int64: those with contact."""
    covered: np.ndarray
    """Shape (n,), bool: whether the target coverage is reached."""
    late: np.ndarray
    """Shape (n,), bool: whether the time is up."""
    command: np.ndarray
    """Shape (n, 2), float32: the last one."""

    @classmethod
    def of(cls, num_seen: np.ndarray, num_explorable: np.ndarray) -> "Tallies":
        """Make rows beside those of the seen and the explorable cells."""
        num_lanes = len(num_seen)
        return cls(
            num_seen,
            num_explorable,
            steps=np.zeros(num_lanes, dtype=np.int64),
            touches=np.zeros(num_lanes, dtype=np.int64),
            covered=np.zeros(num_lanes, dtype=np.bool_),
            late=np.zeros(num_lanes, dtype=np.bool_),
            command=np.zeros((num_lanes, 2), dtype=np.float32),
        )


@njit(cache=True, error_model="numpy")
def _draw_noise(i, simulator_rng, slam_rng, lanes, told_pose):
    """Draw lane `i`'s noise from its own generators, in the order in which simulator and SLAM do."""
    for k in range(lanes.normals.shape[1]):
        lanes.normals[i, k] = simulator_rng.standard_normal()
    for k in range(lanes.uniforms.shape[1]):
        lanes.uniforms[i, k] = simulator_rng.random()
    if not told_pose:
        for k in range(lanes.candidates.shape[1]):
            for axis in range(3):
                lanes.candidates[i, k, axis] = slam_rng.standard_normal()


@njit(cache=True, error_model="numpy")
def _as_seen(velocity, limit):
    """Return a velocity as observations show it, as a share of the limit in single precision."""
    return np.float64(np.float32(min(max(velocity / limit, -1.0), 1.0))) * limit


@njit(cache=True, error_model="numpy", nogil=True)
def drive_on(
    thread,
    i,
    has_been_given_room,
    has_movers,
    pilots,
    block,
    simulator_rng,
    slam_rng,
    target,
    tallies,
    lanes,
    numbers,
    pilot_numbers,
    directions,
    scratch,
):
    """Drive lane `i` until its pilot has something to say.

    Args:
        thread: row of `scratch` to work in.
        i: the lane.
        has_been_given_room: whether the last call ended with `ROOM`: its step is finished first.
        has_movers: whether circles move in this lane, and need to be moved after each step.
        pilots: `Pilots` of the lane.
        block: side of a planning cell [map cells].
        simulator_rng: the lane's generator for the simulator.
        slam_rng: that for the SLAM.
        target: explored fraction that ends the episode.
        tallies: of all lanes, written.
        lanes: all lanes, written.
        numbers: what they share.
        pilot_numbers: `PilotNumbers`.
        directions: shape (2, num_beams), float64: cosine and sine of the beams in the base frame.
        scratch: room to work in.

    Returns:
        What `judge` says, `OVER`, `ROOM` or `STEPPED`.
    """
    pilot, command = pilots.pilot[0], tallies.command[i]
    max_v, max_w = numbers.drive.max_v, numbers.drive.max_w
    while True:
        if not has_been_given_room:
            x, y, theta = lanes.belief[i]
            v_now = _as_seen(lanes.twist[i, 0], max_v)
            act(pilot, pilots.path, pilots.obstacles, x, y, theta, v_now, pilot_numbers, command)
            _draw_noise(i, simulator_rng, slam_rng, lanes, numbers.told_pose)
            motion = drive(i, command, lanes, numbers)
            locate(i, motion, lanes, numbers, directions, scratch.points[thread])
            if not has_room(i, lanes, numbers, directions, scratch.ends[thread]):
                return ROOM
        has_been_given_room = False
        lanes.gained[i] = 0
        if lanes.quality[i] >= 0.0:
            draw(i, lanes, numbers, directions, scratch.ends[thread], scratch.new_cells[thread])
        mark_trail(i, lanes, numbers)
        tallies.num_seen[i] += lanes.gained[i]
        tallies.steps[i] += 1
        tallies.touches[i] += lanes.bumper[i]
        v, w = _as_seen(lanes.twist[i, 0], max_v), _as_seen(lanes.twist[i, 1], max_w)
        sense(pilot, pilots.obstacles, lanes.ranges[i], directions, v, w, lanes.bumper[i], pilot_numbers)
        tallies.covered[i] = tallies.num_seen[i] / tallies.num_explorable[i] >= target
        tallies.late[i] = lanes.steps[i] * numbers.period >= lanes.time_limit[i] - 1e-6
        if tallies.covered[i] or tallies.late[i]:
            code = OVER
        else:
            x, y, theta = lanes.belief[i]
            resolution = numbers.resolution
            code = judge(
                pilot,
                pilots.obstacles,
                x,
                y,
                theta,
                lanes.bumper[i],
                array_at(lanes.map[i, 1], lanes.map[i, 2], lanes.map[i, 3], np.int8),
                resolution,
                lanes.corner[i, 0] * resolution,
                lanes.corner[i, 1] * resolution,
                block,
                pilots.given_up,
                pilot_numbers,
            )
        if code != DRIVING:
            measure_error(i, lanes)
            return code
        if has_movers:
            return STEPPED
