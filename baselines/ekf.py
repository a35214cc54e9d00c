"""The extended Kalman filter of seed 4. Environments fuse with it too, so its home is below theirs and this is its name here."""

from envs.localization.ekf import KINDS, Ekf, EkfParams, Estimate, Kind, Measurement, Verdict

__all__ = ["KINDS", "Ekf", "EkfParams", "Estimate", "Kind", "Measurement", "Verdict"]
