"""The stated budget of the tension cell, held against the simulated truth over many drawn cells."""
