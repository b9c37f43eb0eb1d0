"""The supervisor process: starts the others, and starts them anew."""
