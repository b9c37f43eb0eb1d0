"""Commissioning: identification, responses and fits, and the proposal that follows from them."""
