"""The real-time process: one thread owns the bus and the law."""
