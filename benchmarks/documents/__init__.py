"""Experiments of the four documents that this package reproduces."""
