"""Classic explorers and the path follower that they drive with."""
