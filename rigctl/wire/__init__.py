"""Code shared by gateway and clients for the network: keys, session, blocks, messages, schema."""
