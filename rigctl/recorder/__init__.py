"""The recorder process: writes audit log, trip dumps and recording straight from the rings."""
