"""The paper's study on the simulated rig: every figure that can be checked, passive and with the loop closed."""
