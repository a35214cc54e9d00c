"""What SLAMs, localizers and planners make of drives: `python -m lidarnaut.benchmarks.drives STAGE`."""
