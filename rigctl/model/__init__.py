"""The rig's vocabulary: faults, checks, signals, states, verbs and events, with their words.

Everything else may import it; it imports nothing of the project.
"""
