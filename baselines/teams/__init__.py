"""Exploration by teams."""
