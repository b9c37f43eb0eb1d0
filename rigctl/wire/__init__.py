"""What gateway and clients share on the network: keys, session, blocks, messages, schema."""
