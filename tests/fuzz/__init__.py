"""Random input in bulk: ``python -m tests.fuzz`` plays the full counts, the test suite a share of them."""
