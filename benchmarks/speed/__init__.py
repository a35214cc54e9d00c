"""Benchmarks of throughput, and of compiled (Numba) kernels."""
