"""Measures of the drives, and the paper's results."""

import numpy as np
from scipy.stats import chi2

from envs.logs import rms

from .drive import Drive

PAPER = {
    "position_rmse": 0.0203,
    "heading_rmse": 0.6939,
    "max_x": 0.03,
    "max_y": 0.028,
    "max_heading": 3.3,
}
"""Results of Nguyen et al. (2021) for the full fusion: errors of the position [m] and of the heading [deg], root mean
square (equations 11 and 12) and greatest."""


def nees_bounds(num_drives: int) -> tuple[float, float]:
    """Return the 95 % bounds of the mean NEES of poses over drives."""
    low, high = chi2.ppf([0.025, 0.975], 3 * num_drives) / num_drives
    return float(low), float(high)


def measure(drives: list[Drive], fusion: str) -> dict[str, float]:
    """Measure a fusion over drives under one physics.

    Returns:
        The median over the drives of each of the paper's measures, and as `{name}_worst` the worst drive's. `nees`: the
        mean NEES of the pose over all drives and times, 3 for a consistent estimate, more for an overconfident one.
        `nees_within`: the share of control periods in which the mean over the drives lies within `nees_bounds`.
    """
    measured: dict[str, list[float]] = {key: [] for key in PAPER}
    for drive in drives:
        error = drive.error(fusion) * (1.0, 1.0, np.degrees(1.0))
        values = (rms(np.hypot(error[:, 0], error[:, 1])), rms(error[:, 2]), *np.abs(error).max(axis=0).tolist())
        for key, value in zip(PAPER, values):
            measured[key].append(value)
    steps = min(len(drive.time) for drive in drives)
    nees = np.array([drive.nees(fusion)[:steps] for drive in drives])
    low, high = nees_bounds(len(drives))
    mean = nees.mean(axis=0)
    return {
        **{key: float(np.median(values)) for key, values in measured.items()},
        **{f"{key}_worst": max(values) for key, values in measured.items()},
        "nees": float(nees.mean()),
        "nees_within": float(np.mean((low <= mean) & (mean <= high))),
    }
