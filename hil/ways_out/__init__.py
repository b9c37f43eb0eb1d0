"""The way out of the state that each fault of the catalogue ends in."""
