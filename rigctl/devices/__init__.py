"""Frames of the rig's devices: object definitions, codecs and start-up."""
