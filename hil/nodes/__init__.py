"""The rig's CANopen devices: frames on one side, the plant on the other."""
