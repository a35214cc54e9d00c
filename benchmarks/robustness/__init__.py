"""What hostile inputs, kills, long runs, walls and repetitions do to the project."""
