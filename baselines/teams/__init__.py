"""Teams: assignment of frontiers to robots, and the explorer of teams."""
