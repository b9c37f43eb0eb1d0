"""Trials that measure, and the probe of the margins.

It is entered by `trials.begin` and `loop_probe.LoopProbe`.
"""
