"""Benchmarks: the arena, recorded drives, throughput, and the demo."""
