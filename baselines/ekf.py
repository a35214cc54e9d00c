"""The extended Kalman filter of seed 4; environments fuse with it too, so it lives below them."""

from envs.localization.ekf import KINDS, Ekf, EkfParams, Estimate, Kind, Measurement, Verdict

__all__ = ["KINDS", "Ekf", "EkfParams", "Estimate", "Kind", "Measurement", "Verdict"]
