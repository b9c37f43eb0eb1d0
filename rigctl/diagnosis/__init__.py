"""Which part a trip is about: residuals of the recorded signals around it, and one table of what each fault shows."""
