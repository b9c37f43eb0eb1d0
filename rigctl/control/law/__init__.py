"""The control law, the Kalman filter, and what they know of the disturbance.

It is entered by `tension.TensionLaw` and `estimator.TensionFilter`.
"""
