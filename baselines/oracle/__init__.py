"""Oracle explorer, which knows the true map."""
