"""Scan matchers that work on log-odds maps."""
