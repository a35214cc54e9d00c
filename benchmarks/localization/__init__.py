"""How well AMCL localizes on known maps, and what an update costs: `python -m benchmarks.localization`."""
