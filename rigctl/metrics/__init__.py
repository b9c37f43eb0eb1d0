"""Equation (16), its windows, and percentiles."""
