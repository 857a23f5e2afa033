"""One link between the host and a PLC, with its handshake and operations."""
