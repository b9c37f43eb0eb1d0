"""Plants and gains with python-control and filterpy, and their margins. Never used by the control process."""
