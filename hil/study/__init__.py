"""The frame of the studies: planned runs, their pieces in parallel processes, tables and pictures."""
