"""Rapidly-exploring random trees that find frontiers, for one robot and for several (RRT exploration report, 2022)."""
