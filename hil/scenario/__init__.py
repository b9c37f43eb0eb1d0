"""One scenario, described in a file, played against the simulated rig: docs/scenario.md is its page."""
