"""Measures of the drives, and the paper's results."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from .drive import Drive

DIMENSIONS = 3
"""Of a pose: x, y, heading."""


@dataclass(frozen=True, slots=True)
class Measures:
    """Errors of one fusion: the median over the drives, and the worst drive's."""

    position_rmse: float
    """Root mean square error of the position, equation (11), median [m]."""
    position_rmse_worst: float
    """The same, worst [m]."""
    heading_rmse: float
    """Root mean square error of the heading, equation (12), median [deg]."""
    heading_rmse_worst: float
    """The same, worst [deg]."""
    max_x: float
    """Greatest error along x, median [m]."""
    max_x_worst: float
    """The same, worst [m]."""
    max_y: float
    """Greatest error along y, median [m]."""
    max_y_worst: float
    """The same, worst [m]."""
    max_heading: float
    """Greatest error of the heading, median [deg]."""
    max_heading_worst: float
    """The same, worst [deg]."""
    nees: float
    """Mean normalised estimation error squared of the pose over all drives and times; 3 for a consistent estimate, more
    for an overconfident one."""
    nees_within: float
    """Share of control periods in which the mean over the drives lies within the 95 % bounds of chi-square."""


PAPER = {
    "position_rmse": 0.0203,
    "heading_rmse": 0.6939,
    "max_x": 0.03,
    "max_y": 0.028,
    "max_heading": 3.3,
}
"""Results of Nguyen et al. (2021) for the full fusion; units as in `Measures`."""


def nees_bounds(num_drives: int) -> tuple[float, float]:
    """Return the 95 % bounds of the mean over drives."""
    low, high = chi2.ppf([0.025, 0.975], DIMENSIONS * num_drives) / num_drives
    return float(low), float(high)


def measure(drives: list[Drive], fusion: str) -> Measures:
    """Measure a fusion over drives under one physics."""
    errors = [drive.error(fusion) for drive in drives]
    position = np.array([np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1))) for error in errors])
    heading = np.degrees([np.sqrt(np.mean(error[:, 2] ** 2)) for error in errors])
    greatest = np.array([np.abs(error).max(axis=0) for error in errors])
    steps = min(len(error) for error in errors)
    nees = np.array([drive.nees(fusion)[:steps] for drive in drives])
    low, high = nees_bounds(len(drives))
    mean = nees.mean(axis=0)
    figures = (position, heading, greatest[:, 0], greatest[:, 1], np.degrees(greatest[:, 2]))
    both = [float(value) for figure in figures for value in (np.median(figure), figure.max())]
    return Measures(*both, nees=float(nees.mean()), nees_within=float(np.mean((low <= mean) & (mean <= high))))
