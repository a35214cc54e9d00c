"""Occupancy grid maps that scans are integrated into."""
