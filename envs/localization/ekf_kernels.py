"""Kernels of the Kalman filter in `ekf.py`: prediction, innovation, update.

Arrays are float64: `state`, shape (5,); `covariance` P, shape (5, 5); of a measurement its `values`, shape (k,), their
covariance `noise` R, shape (k, k), and `measured`, shape (k,), int64, the entries of the state that it measures.
"""

import math

import numpy as np
from numba import njit

from envs.geometry import wrap_angle

X, Y, THETA, V, W = range(5)
"""Entries of the state: pose in the map frame [m, m, rad], forward speed [m/s], yaw rate [rad/s]."""
STATE_SIZE = 5
"""Number of entries of the state."""
MAX_STEPS = 5000
"""Greatest number of steps of a prediction; after a long time without measurements they become longer."""


@njit(cache=True, error_model="numpy")
def predict(state, covariance, duration, noise, max_step):
    """Predict the state and its covariance in place: equations (2) and (3), and P = F P F^T + Q.

    Takes a `duration` in steps of at most `max_step` [s]; `noise`, shape (5,), float64, are the spectral densities of
    the process noise [unit^2/s].
    """
    num_steps = min(max(math.ceil(duration / max_step - 1e-6), 1), MAX_STEPS)
    dt = duration / num_steps
    for _ in range(num_steps):
        c, s = math.cos(state[THETA]), math.sin(state[THETA])
        turn_x, turn_y = -state[V] * dt * s, state[V] * dt * c
        state[X] += state[V] * dt * c
        state[Y] += state[V] * dt * s
        state[THETA] += state[W] * dt
        # F differs from the identity in five entries: first F P, row by row, then (F P) F^T, column by column.
        for j in range(STATE_SIZE):
            covariance[X, j] += turn_x * covariance[THETA, j] + dt * c * covariance[V, j]
            covariance[Y, j] += turn_y * covariance[THETA, j] + dt * s * covariance[V, j]
            covariance[THETA, j] += dt * covariance[W, j]
        for i in range(STATE_SIZE):
            covariance[i, X] += turn_x * covariance[i, THETA] + dt * c * covariance[i, V]
            covariance[i, Y] += turn_y * covariance[i, THETA] + dt * s * covariance[i, V]
            covariance[i, THETA] += dt * covariance[i, W]
            covariance[i, i] += noise[i] * dt
    state[THETA] = wrap_angle(state[THETA])


@njit(cache=True, error_model="numpy")
def innovation_of(state, covariance, measured, values, noise):
    """Compute the innovation of a measurement.

    Returns:
        The innovation, shape (k,), its heading wrapped; its covariance S, shape (k, k); and its normalised innovation
        squared (NIS), which is chi-square distributed with k degrees of freedom if the filter is consistent.
    """
    size = measured.shape[0]
    innovation, spread = np.empty(size), np.empty((size, size))
    for i in range(size):
        innovation[i] = values[i] - state[measured[i]]
        if measured[i] == THETA:
            innovation[i] = wrap_angle(innovation[i])
        for j in range(size):
            spread[i, j] = covariance[measured[i], measured[j]] + noise[i, j]
    return innovation, spread, np.dot(innovation, np.linalg.solve(spread, innovation))


@njit(cache=True, error_model="numpy")
def correct(state, covariance, measured, innovation, spread, noise):
    """Update the state in place by a measurement with its innovation and S, from `innovation_of`.

    Returns:
        The covariance after the update, in Joseph's form.
    """
    size = measured.shape[0]
    rows = np.empty((size, STATE_SIZE))
    for i in range(size):
        rows[i] = covariance[measured[i]]
    gain = np.ascontiguousarray(np.linalg.solve(spread, rows).T)
    state += np.dot(gain, innovation)
    state[THETA] = wrap_angle(state[THETA])
    kept = np.eye(STATE_SIZE)
    for i in range(size):
        kept[:, measured[i]] -= gain[:, i]
    corrected = kept @ covariance @ kept.T + gain @ noise @ gain.T
    return 0.5 * (corrected + corrected.T)
