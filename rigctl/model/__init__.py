"""The rig's vocabulary: faults, checks, signals, states and verbs, with their words.

Everything else may import it; it imports nothing of the project.
"""
