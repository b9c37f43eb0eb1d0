"""Digests of what the loop, its devices and the plant do in many runs: two commits are compared by them."""
