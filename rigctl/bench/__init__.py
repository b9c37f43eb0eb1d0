"""``rigctl bench``: does this host keep the loop's time? Measured on the simulated rig, beside cyclictest."""
