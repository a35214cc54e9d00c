"""The arena: explorers in the same worlds with the same seeds, their measures, and a report."""
