"""Benchmarks of throughput and kernels."""
