/* Does the wheel turn as the motor's torque says? (`tricycle_sim/plc/wheel.py` in Python; section
 * 5.8 of docs/protocol.md.) */
#ifndef WHEEL_H
#define WHEEL_H

#include <stdbool.h>
#include <stdint.h>

struct wheel {
	float pulse; /* m */
	float light; /* kg m, of mass at the tread times radius */
	float heavy;
	float torque; /* N m, behind its demand */
	float low;    /* m/s^2, interval of slopes */
	float high;
	float speed_error; /* m/s, of the speed below */
	float speed;       /* m/s, where the gains and ways below began */
	float slow_gain;   /* m/s, of the heaviest vehicle where the motor pushes */
	float slow_travel; /* m */
	float fast_gain;
	float fast_travel;
	float window_gain; /* m/s */
	float window_speed;
	int32_t count;       /* pulses since then */
	int32_t last;        /* pulses of the last tick that had some */
	uint16_t ticks;      /* since then */
	uint16_t silence;    /* ticks since a pulse */
	uint16_t window;     /* ticks */
	float wanted;        /* m by the set-point, since the last pulse */
	uint16_t waiting;    /* ticks in which one should have come since then */
	uint16_t rested;     /* ticks since the motor pushed */
};

/* Lengths in m, masses in kg; forgets all. */
void wheel_set_up(struct wheel *wheel, float pulse, float radius, float mass_low, float mass_high);

/* Begins at rest. */
void wheel_restart(struct wheel *wheel);

/* Begins at rest: the motor is off, or the brake is on. Once a tick. */
void wheel_rest(struct wheel *wheel, int32_t pulses);

/* Whether a wheel that seems to rest does: without its sensor it always seems to. */
bool wheel_rests(const struct wheel *wheel);

/* Whether torque (N m, of the last tick) and pulses (since the last tick) do not fit together any
 * more; they, speed and set-point (m/s) are positive in the direction of the gear. Once a tick. */
bool wheel_fails(struct wheel *wheel, float torque, int32_t pulses, float speed, float setpoint);

#endif
