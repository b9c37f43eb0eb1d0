"""The tension law against its rivals: same plant, frames and limits, another feedback."""
