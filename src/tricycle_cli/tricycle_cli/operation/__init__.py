"""What the operator does: start nodes, arm, drive, record, watch."""
