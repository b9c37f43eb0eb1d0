"""The plant as an FMU (FMI 3.0 co-simulation): compiled C, translated from the plant's own kernel."""
