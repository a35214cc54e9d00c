"""Where a robot takes itself to be, and what it takes its surroundings for."""
