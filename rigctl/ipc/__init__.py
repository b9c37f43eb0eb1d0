"""What the processes share: rings, the record, the run-time folder, the ledger, files written whole."""
