"""The hold service: HOLD from this computer's operators to the loop, on a path that nothing else uses."""
