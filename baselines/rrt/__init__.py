"""Exploration by rapidly-exploring random trees, for one or several robots (RRT exploration report, 2022)."""
