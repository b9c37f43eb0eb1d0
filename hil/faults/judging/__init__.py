"""What judges a run: tension, names of parts, and what the records say, against the plant's truth.

It is entered by `judge`.
"""
