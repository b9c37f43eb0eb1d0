"""The fault catalogue: what may fail, what has to happen then, and what does happen."""
