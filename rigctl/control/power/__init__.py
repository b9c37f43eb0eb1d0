"""The sequence of drive, brake and load as one machine, and what the drive is commanded.

It is entered by `machine.Machine` and, for the tick's command, `drive_command.DriveCommand`.
"""
