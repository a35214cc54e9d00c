"""A learned explorer that chooses frontiers: a score of candidates, trained by evolution in the abstract simulator."""
