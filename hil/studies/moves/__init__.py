"""The same move again and again: what learning takes away, and what dither and prediction do at the reversal."""
