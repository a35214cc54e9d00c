"""Benchmarks: evaluation of policies (arena), accuracy on recorded drives, throughput, and a demo."""
