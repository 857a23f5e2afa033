"""One count of each quantity on the wire, in SI (docs/protocol.md, section 2)."""

ANGLE_UNIT = 1e-4  # rad
STEER_RATE_UNIT = 1e-3  # rad/s
SPEED_UNIT = 1e-3  # m/s; accelerations likewise 1e-3 m/s^2
BRAKE_UNIT = 0.005  # full brake = 200
TRAVEL_UNIT = 1e-6  # m, per hall pulse
VOLTAGE_UNIT = 1e-3  # V
CURRENT_UNIT = 1e-3  # A
LENGTH_UNIT = 1e-4  # m, of the tyre radius
TORQUE_UNIT = 0.01  # N m
MASS_UNIT = 0.1  # kg
