"""The rig's CANopen devices. Each speaks frames on one side and reads or drives the plant on the other."""
