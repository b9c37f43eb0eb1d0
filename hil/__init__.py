"""The simulated rig: plant, sensors, drive and bus, spoken to through CAN frames only."""
