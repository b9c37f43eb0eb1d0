"""What an operator's command does with a rig beside the loop: rules about values, entries of the ledger."""
