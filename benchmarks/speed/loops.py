"""Compiled loops around kernels: from Python each call would cost microseconds of its own.

They are compiled anew in each run, since cached ones would not notice that a kernel has changed.
"""

from numba import njit

from envs.coverage import count_new
from envs.geometry.raycast import cast_rays
from envs.map_pyramid import crop_pyramid, pool_map
from envs.simulation.kinematic import advance
from envs.slam.map_update import beam_ends, draw_scan
from envs.slam.matcher import match

_LITTLE = 1e-9
"""By how much an argument differs from call to call, such that no compiler takes the work out of the loop."""


@njit
def repeat_cast_rays(times, x, y, heading, beams, segments, circles, out):
    for i in range(times):
        cast_rays(x + _LITTLE * i, y, heading, beams, segments, circles, out)


@njit
def repeat_match(times, words, points, count, unvisited, x, y, theta, search):
    for i in range(times):
        match(words, points, count, unvisited, x + _LITTLE * i, y, theta, *search)


@njit
def repeat_draw_scan(times, words, occupancy, scan, x, y, c, s, resolution, ends, how, new_cells):
    for i in range(times):
        beam_ends(*scan, x + _LITTLE * i, y, c, s, resolution, ends)
        draw_scan(words, occupancy, scan[0], scan[2], ends, x, y, *how, new_cells)


@njit
def repeat_crop(times, near, far, height, width, block, resolution, x, y, theta, crop_near, crop_far):
    for i in range(times):
        crop_pyramid(near, far, height, width, block, resolution, x + _LITTLE * i, y, theta, crop_near, crop_far)


@njit
def repeat_pool_map(times, data, touched, block, near, far):
    for _ in range(times):
        pool_map(data, *touched, block, near, far)


@njit
def repeat_count_new(times, cells, map_frame, x, y, theta, explorable, world_frame, seen):
    for i in range(times):
        seen[:] = False
        count_new(cells, *map_frame, x + _LITTLE * i, y, theta, explorable, *world_frame, seen)


@njit
def repeat_advance(times, state, command, normals, timing, drive, obstacles):
    for _ in range(times):
        advance(state, command, normals, timing, drive, obstacles)
