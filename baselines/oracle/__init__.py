"""The bound: an explorer that uses ground truth."""
