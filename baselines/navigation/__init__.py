"""Navigation on a known map: the classic policy of `lidarnaut/Navigate-v0`, and driving while the pose is unknown."""
