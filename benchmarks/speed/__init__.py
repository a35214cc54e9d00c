"""Benchmarks of throughput."""
