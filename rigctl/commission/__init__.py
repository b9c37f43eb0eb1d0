"""Commissioning: tare, calibration check and identification, what they find and where it is written down."""
