"""What `python -m benchmarks.localization` is made of."""
