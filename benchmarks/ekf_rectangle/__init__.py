"""Experiment of Nguyen et al. (2021), see `docs/ekf.md`: four estimates of the pose along a rectangle of 78 m."""
