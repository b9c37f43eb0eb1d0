"""Plant family, gains and margins with python-control. Used by the supervisor, never by the control process."""
