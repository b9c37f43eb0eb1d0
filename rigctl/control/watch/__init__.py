"""The safety table, the limits, the escalation, and detectors of what contradicts.

It is entered by `safety.Watch`; its rows read the snapshot alone.
"""
