"""Graph SLAM: submaps, a pose graph over them, and loop closures."""
