"""The rig file: its sections, strict YAML, DBC files, and the wording of errors."""
