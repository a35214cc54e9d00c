"""The arena: explorers on the same places with the same seeds, their measures, and a report."""
