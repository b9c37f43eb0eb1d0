"""Mutation testing of what nothing may get wrong: modes, safety table, tension law."""
