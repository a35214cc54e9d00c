"""Frontier exploration."""
