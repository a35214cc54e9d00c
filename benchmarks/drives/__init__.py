"""Benchmarks of SLAM, localization and planning on recorded drives."""
