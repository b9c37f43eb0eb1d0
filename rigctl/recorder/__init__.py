"""The recorder process: what is kept of a rig's running, straight from the rings."""
