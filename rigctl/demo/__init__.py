"""``rigctl demo``: the daemon's main job on the simulated rig, played, watched and judged."""
