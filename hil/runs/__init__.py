"""The frame of catalogue, draws and studies: pieces in parallel processes, rows kept in a file, tables."""
