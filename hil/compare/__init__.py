"""The tension law against its rivals: same plant, same frames, same limits, another feedback."""
