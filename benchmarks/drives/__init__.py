"""What SLAMs, localizers and planners make of drives: `python -m benchmarks.drives STAGE`."""
