"""Operation of the vehicle: start nodes, arm, drive, record, watch."""
