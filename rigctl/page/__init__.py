"""The live page: a Zenoh client of the daemon that serves charts and, with operator rights, commands over HTTP."""
