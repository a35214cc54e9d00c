"""Completion of maps: a network that predicts the floor beyond the known part of a map."""
