"""Many kinematic robots side by side: the step of `ExploreEnv` as a kernel over lanes.

Each lane is an `ExploreEnv`, which does its resets. Between them its numbers live in rows of shared arrays; what
differs in size from lane to lane (walls, maps, masks) stays where the environment put it, and is reached by its
address. The kernels call the functions that the single environment calls.
"""

import math

import numpy as np
from numba import carray, njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from envs.coverage import count_new
from envs.estimation.motion import wheel_motion
from envs.geometry.pose import between, compose, distance, wrap_angle
from envs.map_pyramid import crop_pyramid, mark_visited, pool_map
from envs.observation import fill_motion, is_apart, scale_scan
from envs.simulation.drive import Timing
from envs.simulation.kinematic import Obstacles, advance
from envs.simulation.sensors import OTHER_NORMALS, measure_ranges
from envs.simulation.state import LEFT_ANGLE, RIGHT_ANGLE, THETA, X, Y
from envs.slam.grid_map import has_moved
from envs.slam.map_update import beam_ends, draw_scan
from envs.slam.matcher import match, project_hits


@intrinsic
def _as_pointer(typing_context, address):
    """Turn an integer into the pointer that it is."""

    def generate(context, builder, signature, args):
        return builder.inttoptr(args[0], cgutils.voidptr_t)

    return types.voidptr(address), generate


@njit(cache=True)
def array_at(address, height, width, dtype):
    """Return the C-contiguous array, shape (height, width), that lies at an address."""
    return carray(_as_pointer(address), (height, width), dtype)  # type: ignore[call-arg]


@njit(cache=True, error_model="numpy")
def drive(i, command, lanes, numbers):
    """Move lane `i`, scan, and return the motion [m, m, rad] that its SLAM is told."""
    state = lanes.state[i]
    segments = array_at(lanes.segments[i, 0], lanes.segments[i, 1], 4, np.float64)
    before = array_at(lanes.circles[i, 0], lanes.circles[i, 2], 3, np.float64)
    after = array_at(lanes.circles[i, 1], lanes.circles[i, 2], 3, np.float64)
    x, y, theta = state[X], state[Y], state[THETA]
    v = command[0] * numbers.drive.max_v
    w = command[1] * numbers.drive.max_w
    normals = lanes.normals[i]
    touching = lanes.bumper[i]
    lanes.bumper[i], _ = advance(
        state,
        (v, w),
        normals,
        Timing(numbers.period, numbers.substeps),
        numbers.drive,
        Obstacles(segments, before, after),
    )
    lanes.collisions[i] += lanes.bumper[i] and not touching
    lanes.path_length[i] += distance(state[X] - x, state[Y] - y)
    lanes.steps[i] += 1
    beams = normals[OTHER_NORMALS:]
    measure_ranges(state, beams, lanes.uniforms[i], numbers.lidar, segments, after, lanes.ranges[i])
    left = math.floor(state[LEFT_ANGLE] * numbers.ticks_per_radian)
    right = math.floor(state[RIGHT_ANGLE] * numbers.ticks_per_radian)
    motion = wheel_motion(
        left - lanes.ticks[i, 0], right - lanes.ticks[i, 1], numbers.metres_per_tick, numbers.odometry_track
    )
    lanes.ticks[i, 0], lanes.ticks[i, 1] = left, right
    lanes.twist[i, 0], lanes.twist[i, 1] = motion[0] / numbers.period, motion[2] / numbers.period
    if numbers.told_truth:
        return between(x, y, theta, state[X], state[Y], state[THETA])
    return motion


@njit(cache=True, error_model="numpy")
def locate(i, motion, lanes, numbers, directions, points):
    """Find lane `i`'s pose by its SLAM, and decide how the scan is to be drawn."""
    x, y, theta = lanes.belief[i]
    x, y, theta = compose(x, y, theta, motion[0], motion[1], motion[2])
    quality = numbers.quality
    if not numbers.told_pose:
        words = array_at(lanes.map[i, 0], lanes.map[i, 2], lanes.map[i, 3], np.int32)
        ranges, lidar, resolution = lanes.ranges[i], numbers.lidar, numbers.resolution
        count = project_hits(ranges, lidar.range_max, directions, lidar.mount_x, lidar.mount_y, resolution, points)
        col, row = lanes.corner[i, 0], lanes.corner[i, 1]
        best_x, best_y, best_theta, _, accepted, _ = match(
            words,
            points,
            count,
            numbers.unvisited,
            x / resolution - col,
            y / resolution - row,
            theta,
            numbers.sigma_xy,
            numbers.sigma_theta,
            numbers.max_failed,
            numbers.max_tries,
            lanes.candidates[i],
            np.empty((0, 5)),
        )
        if accepted:
            x, y, theta = (best_x + col) * resolution, (best_y + row) * resolution, wrap_angle(best_theta)
        else:
            quality = numbers.raw_quality
    lanes.belief[i, 0], lanes.belief[i, 1], lanes.belief[i, 2] = x, y, theta
    drawn = lanes.drawn[i]
    moved = has_moved(drawn[0], drawn[1], drawn[2], x, y, theta, numbers.draw_distance, numbers.draw_angle)
    lanes.quality[i] = quality if moved else -1.0


@njit(cache=True, error_model="numpy")
def _end_beams(i, lanes, numbers, directions, ends):
    """Find where lane `i`'s beams end in its map; return the lidar's cell position and the extent of the scan."""
    x, y, theta = lanes.belief[i]
    c, s = math.cos(theta), math.sin(theta)
    lidar, resolution = numbers.lidar, numbers.resolution
    col = (x + c * lidar.mount_x - s * lidar.mount_y) / resolution - lanes.corner[i, 0]
    row = (y + s * lidar.mount_x + c * lidar.mount_y) / resolution - lanes.corner[i, 1]
    extent = beam_ends(
        lanes.ranges[i], directions, lidar.range_max, numbers.skip_exceeding, col, row, c, s, resolution, ends
    )
    return col, row, extent


@njit(cache=True, error_model="numpy")
def has_room(i, lanes, numbers, directions, ends):
    """Tell whether lane `i`'s map and trail have room for what its step adds to them; fills `lanes.touched`."""
    lanes.touched[i] = 0
    if lanes.quality[i] >= 0.0:
        _, _, extent = _end_beams(i, lanes, numbers, directions, ends)
        for k in range(4):
            lanes.touched[i, k] = extent[k]
    col_min, row_min, col_max, row_max = lanes.touched[i]
    inside = col_min >= 0 and row_min >= 0 and col_max < lanes.map[i, 3] and row_max < lanes.map[i, 2]
    return inside and lanes.trail[i, 1] < lanes.trail[i, 2]


@njit(cache=True, error_model="numpy")
def _levels(i, lanes):
    """Return the levels of lane `i`'s map pyramid."""
    pyramid = lanes.pyramid[i]
    near, far = array_at(pyramid[0], 1, pyramid[1], np.uint16), array_at(pyramid[2], 1, pyramid[3], np.uint16)
    return near[0], far[0]


@njit(cache=True, error_model="numpy")
def draw(i, lanes, numbers, directions, ends, new_cells):
    """Draw lane `i`'s scan into its map, and count what became truly known."""
    words = array_at(lanes.map[i, 0], lanes.map[i, 2], lanes.map[i, 3], np.int32)
    occupancy = array_at(lanes.map[i, 1], lanes.map[i, 2], lanes.map[i, 3], np.int8)
    col, row, extent = _end_beams(i, lanes, numbers, directions, ends)
    count = draw_scan(
        words,
        occupancy,
        lanes.ranges[i],
        numbers.lidar.range_max,
        ends,
        col,
        row,
        numbers.cell,
        numbers.by_area,
        numbers.occupied_prob,
        numbers.empty_prob,
        lanes.quality[i],
        numbers.hole,
        numbers.add_blur,
        new_cells,
    )
    near, far = _levels(i, lanes)
    pool_map(occupancy, extent[0], extent[1], extent[2], extent[3], numbers.block, near, far)
    explorable = array_at(lanes.area[i, 0], lanes.area[i, 2], lanes.area[i, 3], np.bool_)
    seen = array_at(lanes.area[i, 1], lanes.area[i, 2], lanes.area[i, 3], np.bool_)
    lanes.gained[i] = count_new(
        new_cells[:count],
        lanes.corner[i, 0] * numbers.resolution,
        lanes.corner[i, 1] * numbers.resolution,
        numbers.resolution,
        lanes.start[i, 0],
        lanes.start[i, 1],
        lanes.start[i, 2],
        explorable,
        lanes.area_frame[i, 0],
        lanes.area_frame[i, 1],
        lanes.area_frame[i, 2],
        seen,
    )
    lanes.drawn[i] = lanes.belief[i]


@njit(cache=True, error_model="numpy")
def mark_trail(i, lanes, numbers):
    """Remember where lane `i` has been."""
    x, y, _ = lanes.belief[i]
    positions = array_at(lanes.trail[i, 0], lanes.trail[i, 1] + 1, 2, np.float64)
    if is_apart(positions, lanes.trail[i, 1], x, y):
        positions[lanes.trail[i, 1], 0], positions[lanes.trail[i, 1], 1] = x, y
        lanes.trail[i, 1] += 1
        near, far = _levels(i, lanes)
        left, low = lanes.corner[i, 0] * numbers.resolution, lanes.corner[i, 1] * numbers.resolution
        col, row = (x - left) / numbers.resolution, (y - low) / numbers.resolution
        mark_visited(col, row, lanes.map[i, 2], lanes.map[i, 3], numbers.block, near, far)


@njit(cache=True, error_model="numpy")
def measure_error(i, lanes):
    """Measure how far lane `i`'s belief is off."""
    x, y, theta = lanes.belief[i]
    believed = compose(lanes.start[i, 0], lanes.start[i, 1], lanes.start[i, 2], x, y, theta)
    state = lanes.state[i]
    error = between(believed[0], believed[1], believed[2], state[X], state[Y], state[THETA])
    lanes.pose_error[i, 0], lanes.pose_error[i, 1] = distance(error[0], error[1]), abs(error[2])


@njit(cache=True, error_model="numpy")
def _view(i, action, lanes, numbers, views):
    """Compose lane `i`'s observation."""
    x, y, theta = lanes.belief[i]
    height, width = lanes.map[i, 2], lanes.map[i, 3]
    left, low = lanes.corner[i, 0] * numbers.resolution, lanes.corner[i, 1] * numbers.resolution
    near, far = _levels(i, lanes)
    crop_pyramid(
        near,
        far,
        height,
        width,
        numbers.block,
        numbers.resolution,
        x - left,
        y - low,
        theta,
        views.map_near[i],
        views.map_far[i],
    )
    scale_scan(lanes.ranges[i], numbers.lidar.range_max, views.scan[i])
    fill_motion(
        lanes.twist[i, 0],
        lanes.twist[i, 1],
        numbers.drive.max_v,
        numbers.drive.max_w,
        action[0],
        action[1],
        lanes.bumper[i],
        lanes.steps[i] * numbers.period / lanes.time_limit[i],
        views.motion[i],
    )


@njit(cache=True, error_model="numpy")
def _finish(thread, i, action, lanes, numbers, directions, scratch, views):
    """Draw lane `i`'s scan if it is due, and compose its observation."""
    lanes.gained[i] = 0
    if lanes.quality[i] >= 0.0:
        draw(i, lanes, numbers, directions, scratch.ends[thread], scratch.new_cells[thread])
    mark_trail(i, lanes, numbers)
    _view(i, action, lanes, numbers, views)
    measure_error(i, lanes)


@njit(cache=True, error_model="numpy", nogil=True)
def step_lanes(thread, first, last, actions, active, waiting, lanes, numbers, directions, scratch, views):
    """Step active lanes: drive, scan, find the pose at which the scan fits the map, draw it, and look.

    Everything is done for one lane before the next, while its map is in the cache. A lane whose map or trail lacks room
    stops before it draws, and waits for `finish_lanes`.

    Args:
        thread: row of `scratch` to work in.
        first: first lane.
        last: lane after the last.
        actions: shape (n, 2), float32.
        active: shape (n,), bool: lanes to step.
        waiting: shape (n,), bool, written: lanes that wait for room.
        lanes: all lanes, written.
        numbers: what they share.
        directions: shape (2, num_beams), float64: cosine and sine of the beams in the base frame.
        scratch: room to work in.
        views: observations, written.
    """
    for i in range(first, last):
        waiting[i] = False
        if active[i]:
            motion = drive(i, actions[i], lanes, numbers)
            locate(i, motion, lanes, numbers, directions, scratch.points[thread])
            if has_room(i, lanes, numbers, directions, scratch.ends[thread]):
                _finish(thread, i, actions[i], lanes, numbers, directions, scratch, views)
            else:
                waiting[i] = True


@njit(cache=True, error_model="numpy", nogil=True)
def finish_lanes(actions, waiting, lanes, numbers, directions, scratch, views):
    """Do for lanes that have been given room what `step_lanes` left to do; arguments as there."""
    for i in range(waiting.shape[0]):
        if waiting[i]:
            _finish(0, i, actions[i], lanes, numbers, directions, scratch, views)
