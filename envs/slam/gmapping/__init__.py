"""GMapping: Rao-Blackwellised particle filter with a map per particle."""
