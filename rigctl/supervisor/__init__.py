"""The supervisor process: starts the others and restarts them."""
