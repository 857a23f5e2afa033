/* The drive's speed: measured from hall pulses, controlled by a PI with the motor's limits. */
#ifndef MOTOR_H
#define MOTOR_H

#include <stdbool.h>
#include <stdint.h>

struct hall {
	int32_t count;    /* at the last tick */
	uint32_t edge_at; /* us, of the newest pulse at the last tick */
	int16_t speed;    /* mm/s */
};

/* Speed at a tick: pulses since the last one over the time between their newest edges; without a
 * pulse no faster than one pulse since then, and 0 after HALL_TIMEOUT_US. */
int16_t hall_speed(struct hall *hall, int32_t count, uint32_t edge_at, uint32_t now);

struct motor {
	int32_t integral; /* urad of the wheel */
};

#define MAX_TORQUE 35000L /* mN m, 1000 per mille of PWM */

/* One 10 ms step of the PI (20 N m s/rad, 20 N m/rad, back-calculation 0.2) with the limits
 * -15 N m, 35 N m, 250 W and the no-load line 9 (15.5 rad/s - speed); returns mN m in the
 * direction of travel. Set-point in 0.01 mm/s and speed in mm/s in that direction too. */
int32_t motor_torque(struct motor *motor, int32_t setpoint, int16_t speed);

#endif
