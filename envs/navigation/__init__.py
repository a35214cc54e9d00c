"""Costmaps, frontiers and path planning on what the robot believes."""
