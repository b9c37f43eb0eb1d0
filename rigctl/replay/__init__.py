"""A recording played through the loop again: the same frames, commands and instants."""
