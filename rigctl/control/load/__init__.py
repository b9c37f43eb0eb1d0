"""What keeps the load: latch of the stroke, parked brake, or a motor that carries for a brake that does not hold.

It is entered by `held_load.HeldLoad` and by the detectors that the observer owns.
"""
