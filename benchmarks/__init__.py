"""Measuring explorers: the arena, the demo."""
