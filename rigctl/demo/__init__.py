"""``rigctl demo``: plays the paper's move on the simulated rig and judges it."""
