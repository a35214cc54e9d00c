"""GMapping: a Rao-Blackwellised particle filter whose particles hold maps."""
