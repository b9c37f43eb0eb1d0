"""A rig file of one's own, made from the paper's rig and a few decisions."""
