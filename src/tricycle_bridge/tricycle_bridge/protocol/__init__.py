"""The by-wire protocol (docs/protocol.md): messages, frames and the PLC's clock."""
