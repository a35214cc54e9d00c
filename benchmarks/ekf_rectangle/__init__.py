"""The experiment of seed 4: a robot drives a rectangle of 78 m, and four estimates of its pose face the truth."""
