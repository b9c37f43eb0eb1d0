"""``make bench``: cost and lateness of the loop, against cyclictest in the same run."""
