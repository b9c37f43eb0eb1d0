"""Figures of a run, from its records and the plant's truth."""
