"""What the boards report: joined into joint readings, and held against other sensors."""
