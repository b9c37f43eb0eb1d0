"""Replay of a recording through the loop, with the same frames, commands and times."""
