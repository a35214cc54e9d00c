"""The arena: evaluation of policies in the same worlds with the same seeds."""
