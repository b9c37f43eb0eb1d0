"""The fault catalogue: faults, the reactions expected in each mode, and their comparison with runs."""
