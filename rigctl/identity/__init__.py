"""Who may do what on the network: keys and certificates of one rig's own authority, roles, and the access list."""
