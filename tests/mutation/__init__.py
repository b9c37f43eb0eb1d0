"""Mutation testing of the modules that safety depends on: modes, safety table, tension law."""
