"""Exploration by rapidly-exploring random trees."""
