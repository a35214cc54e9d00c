"""Scan matchers for log-odds occupancy maps."""
