"""The daemon that holds a suspended antenna mechanism weightless."""

__version__ = "0.1.0"
