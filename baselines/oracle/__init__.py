"""Oracle explorer, which uses ground truth."""
