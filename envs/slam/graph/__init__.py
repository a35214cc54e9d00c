"""Graph SLAM: submaps, loop closures, and a pose graph."""
