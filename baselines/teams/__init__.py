"""Teams that explore by one map: who goes to which frontier, and who lets whom pass."""
