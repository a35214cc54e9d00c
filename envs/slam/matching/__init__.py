"""Matching of scans with maps."""
