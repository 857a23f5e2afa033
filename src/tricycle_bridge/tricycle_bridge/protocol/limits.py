"""Limits and times inside the PLCs, which no host can widen (docs/protocol.md, sections 5, 9)."""

STEERING_END_STOP = 0.7854  # rad, steering motor, either side: the mechanical stop
MAX_STEERING_ANGLE = 0.7854  # rad, steering motor, either side
MAX_STEERING_RATE = 3.0  # rad/s
MAX_SPEED = 4.8  # m/s
MAX_ACCELERATION = 2.0  # m/s^2

WATCHDOG = 0.2  # s without an accepted command until STOPPING
STALE_TICKS = 150  # of ECHO_TICK: an older echo marks a stale command
ECHO_TICK = 1024e-6  # s
ARMING_COMMANDS = 5  # good commands in a row before ARM is accepted
