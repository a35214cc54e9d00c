"""Exploration by rapidly-exploring random trees (RRT exploration report, 2022)."""
