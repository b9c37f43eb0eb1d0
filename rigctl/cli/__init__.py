"""Every command of ``rigctl``: its options and its output."""
