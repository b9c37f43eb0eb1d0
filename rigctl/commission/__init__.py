"""Commissioning: preflight on the host, identification, and the proposal that follows from it."""
