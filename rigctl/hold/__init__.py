"""The hold service: HOLD from this computer's operators to the loop, on a way that nothing else uses."""
