"""Exploration by teams of robots."""
