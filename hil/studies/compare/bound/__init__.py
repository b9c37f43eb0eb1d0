"""The limit of performance: the least error that any linear law reaches on the nominal plant, a convex bound."""
