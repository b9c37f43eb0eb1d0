"""A running rig in the tools people have: the Foxglove WebSocket protocol, Prometheus, and layouts for them."""
