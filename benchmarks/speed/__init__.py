"""What `benchmarks.throughput` measures, and how."""
