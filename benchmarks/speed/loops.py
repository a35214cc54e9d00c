"""Compiled loops around kernels: from Python each call would cost microseconds of its own.

They are compiled anew in each run, since cached ones would not notice that a kernel has changed.
"""

from numba import njit

from envs.estimation.map_pyramid import crop_level, pool_cells
from envs.geometry.raycast import cast_rays
from envs.simulation.kinematic import advance
from envs.slam.map_update import integrate_scan
from envs.slam.matcher import match
from envs.slam.scans import beam_ends

_LITTLE = 1e-9
"""By how much an argument differs from call to call, such that no compiler takes the work out of the loop."""


@njit
def repeat_cast_rays(times, x, y, heading, beams, segments, circles, out):
    for i in range(times):
        cast_rays(x + _LITTLE * i, y, heading, beams, segments, circles, out)


@njit
def repeat_match(times, words, points, count, x, y, theta, params, noise):
    for i in range(times):
        match(words, points, count, (x + _LITTLE * i, y, theta), params, noise)


@njit
def repeat_integrate_scan(times, words, occupancy, scan, x, y, c, s, ends, model, quality, new_cells):
    for i in range(times):
        beam_ends(*scan, x + _LITTLE * i, y, c, s, ends)
        integrate_scan(words, occupancy, ends, x, y, model, quality, new_cells)


@njit
def repeat_crop(times, level, height, width, x, y, theta, pixel, crop):
    for i in range(times):
        crop_level(level, height, width, x + _LITTLE * i, y, theta, pixel, crop)


@njit
def repeat_pool_cells(times, data, window, block, level):
    for _ in range(times):
        pool_cells(data, window, block, level)


@njit
def repeat_advance(times, state, command, normals, timing, drive, obstacles):
    for _ in range(times):
        advance(state, command, normals, timing, drive, obstacles)
