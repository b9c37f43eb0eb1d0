"""One scenario, described in a file and played on the simulated rig; see docs/scenario.md."""
