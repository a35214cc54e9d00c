"""Frontier exploration with a single robot."""
