"""What an operator types: the daemon's clients on the command line."""
