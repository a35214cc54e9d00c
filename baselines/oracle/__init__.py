"""Oracle explorer, which uses ground truth, as an upper bound."""
