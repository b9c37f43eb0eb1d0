"""Every command of ``rigctl``: its options and what it prints."""
