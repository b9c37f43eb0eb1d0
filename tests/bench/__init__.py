"""``make bench``: what the loop costs and how late it is, against cyclictest in the same run."""
