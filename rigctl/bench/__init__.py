"""``rigctl bench``: measures whether this computer keeps the loop's time, on the simulated rig, beside cyclictest."""
