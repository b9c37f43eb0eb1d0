"""Every command of ``python -m hil``: its options and what it prints."""
