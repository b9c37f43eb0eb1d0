"""Which received frames count: those of the rig's own kind, for start-up and loop alike.

A 29-bit identifier, a remote frame or an error frame with the same number is another frame, of foreign traffic.
"""

from __future__ import annotations

from operator import attrgetter

kind_of = attrgetter("is_extended_id", "is_remote_frame", "is_error_frame")
"""Of a `can.Message`; no Python call, for the loop takes several frames a tick."""
OWN_KIND = (False, False, False)
"""A data frame with an 11-bit identifier (CiA 301; a DBC file's messages are the same)."""
