#include "motor.h"

#include "plc.h"

#define HALL_TIMEOUT_US 300000UL
#define FASTEST 30000L         /* mm/s */
#define HARDEST 4000L          /* mm/s^2 */
#define SMOOTHING_MS 320L      /* of the acceleration; below 256 the speed loop can swing */
#define TYRE_RADIUS 335L       /* mm */
#define MIN_TORQUE (-15000L)   /* mN m, regenerative */
#define MAX_POWER 250000L      /* mW */
#define NO_LOAD 15500L         /* mrad/s */
#define NO_LOAD_SLOPE 9L       /* mN m per mrad/s */
#define GAIN 20L               /* mN m per mrad/s, and per mrad */
#define BACK_CALCULATION 67L   /* 0.01 um in 10 ms per mN m: 0.2 rad/s per N m */

static void take_pulses(struct hall *hall, int32_t pulses, uint32_t edge_at)
{
	uint32_t dt = edge_at - hall->edge_at;
	dt = dt < HALL_TIMEOUT_US ? dt : HALL_TIMEOUT_US; /* more is a rest, not a slow wheel */
	dt = dt ? dt : 1;
	/* um/us = m/s; 100 pulses per tick are no wheel any more, and 32 bits hold the product */
	int32_t mean = clamp(pulses, -100, 100) * (HALL_PULSE * 1000L) / (int32_t)dt;
	mean = clamp(mean, -FASTEST, FASTEST);
	uint32_t middle = edge_at - dt / 2;
	uint32_t apart = (middle - hall->middle) / 1000; /* ms */
	int32_t acceleration = 0;
	if (apart < HALL_TIMEOUT_US / 1000)
		acceleration = hall->acceleration +
			       ((mean - hall->mean) * 1000 - hall->acceleration * (int32_t)apart) /
				       SMOOTHING_MS;
	hall->acceleration = (int16_t)clamp(acceleration, -HARDEST, HARDEST);
	hall->mean = (int16_t)mean;
	hall->middle = middle;
	hall->edge_at = edge_at;
}

int32_t hall_travel(struct hall *hall, int32_t count, uint32_t edge_at, uint32_t now)
{
	int32_t pulses = count - hall->count;
	int32_t before = hall->beyond;
	hall->count = count;
	if (pulses)
		take_pulses(hall, pulses, edge_at);
	uint32_t since = now - hall->edge_at;
	int32_t most = since >= HALL_TIMEOUT_US ? 0 :
		       pulses || since == 0     ? FASTEST :
						  HALL_PULSE * 1000L / (int32_t)since;
	int32_t age = (int32_t)((now - hall->middle) / 100); /* 0.1 ms */
	int32_t speed = hall->mean;
	if (most)
		speed += hall->acceleration * age / 10000;
	hall->speed = (int16_t)clamp(speed, -most, most);
	if (pulses)
		hall->beyond = hall->speed * (int32_t)since / 1000;
	else
		hall->beyond += hall->speed * (TICK_US / 1000L);
	hall->beyond = clamp(hall->beyond, -HALL_PULSE, HALL_PULSE);
	return pulses * HALL_PULSE + hall->beyond - before;
}

int32_t motor_torque(struct motor *motor, int32_t setpoint, int16_t speed, int32_t travel)
{
	/* the integral of the error is the way that is missing: counted, not summed up from speeds */
	motor->integral -= 10 * travel;
	int32_t rate = speed * 1000L / TYRE_RADIUS; /* mrad/s */
	int32_t error = setpoint * 10 / TYRE_RADIUS - rate;
	int32_t demand = GAIN * error + GAIN * motor->integral / (10 * TYRE_RADIUS);
	int32_t available = MAX_POWER * 1000 / (rate > 500 ? rate : 500);
	int32_t no_load = NO_LOAD_SLOPE * (NO_LOAD - rate);
	available = available < no_load ? available : no_load;
	available = available < MAX_TORQUE ? available : MAX_TORQUE;
	int32_t torque = demand < available ? demand : available;
	torque = torque > MIN_TORQUE ? torque : MIN_TORQUE;
	/* a set-point of 0.01 mm/s is 0.1 um in the coming 10 ms */
	motor->integral += setpoint + (torque - demand) * BACK_CALCULATION / 10;
	return torque;
}
