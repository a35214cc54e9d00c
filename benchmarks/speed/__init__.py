"""Speed: kernels, physics, environments, decisions and training, beside the usual design of an environment."""
