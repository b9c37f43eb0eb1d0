"""The simulated rig: plant, sensors, drive and bus, reached through CAN frames only."""
