"""How far a load moves between brake and motor."""
