"""Frontier exploration: rules that score frontier candidates, and their explorers."""
