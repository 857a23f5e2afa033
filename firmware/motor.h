/* The drive's speed: measured from hall pulses, controlled by a PI with the motor's limits. */
#ifndef MOTOR_H
#define MOTOR_H

#include <stdbool.h>
#include <stdint.h>

struct hall {
	int32_t count;        /* at the last tick */
	uint32_t edge_at;     /* us, of the newest pulse at the last tick */
	uint32_t middle;      /* us, between the newest pulse and the one before */
	int32_t beyond;       /* um travelled since the newest pulse, estimated */
	int16_t mean;         /* mm/s, between the newest pulse and the one before */
	int16_t acceleration; /* mm/s^2, smoothed */
	int16_t speed;        /* mm/s at the last tick */
	bool rests;           /* no pulse for long; whatever the clock, which wraps, says later */
	bool backward;        /* the newest pulse */
};

/* At rest, anywhere between two pulses; `pulse` is the travel per pulse in um. */
void hall_begin(struct hall *hall, int32_t pulse, int32_t count);

/* Travel since the last tick in um; hall->speed is then the speed at this one: the mean between two
 * pulses, carried on from the middle between them; without a pulse no faster than one pulse since
 * the newest, and 0 after HALL_TIMEOUT_US. Travel is exact at every pulse, so that errors of the
 * speed do not add up. `now` must not be before the newest pulse. */
int32_t hall_travel(struct hall *hall, int32_t pulse, int32_t count, uint32_t edge_at,
		    uint32_t now);

struct motor {
	int32_t integral; /* 0.1 um at the tread */
};

struct motor_limits {
	int32_t tyre_radius;    /* 0.1 mm */
	int32_t torque;         /* mN m */
	int32_t regenerative;   /* mN m, of the braking motor */
	int32_t power;          /* W */
};

/* One 10 ms step of the PI (20 N m s/rad, 20 N m/rad, back-calculation 0.2) with the motor's limits
 * and the no-load line 9 (15.5 rad/s - speed); returns mN m in the direction of travel. Set-point in
 * 0.01 mm/s, speed in mm/s and travel since the last step in um in that direction too. */
int32_t motor_torque(struct motor *motor, const struct motor_limits *limits, int32_t setpoint,
		     int16_t speed, int32_t travel);

#endif
