"""Equation (16), the windows it is taken over, and percentiles."""
