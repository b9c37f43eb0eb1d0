"""The gateway process: publishes what the loop writes, answers commands."""
