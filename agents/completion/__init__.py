"""Completion of maps: a network that predicts the floor beyond what a robot has seen."""
