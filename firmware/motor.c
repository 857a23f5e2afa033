#include "motor.h"

#include "plc.h"

#define HALL_TIMEOUT_US 300000UL
#define FASTEST 30000L     /* mm/s */
#define HARDEST 4000L      /* mm/s^2 */
#define SMOOTHING_MS 320L  /* of the acceleration; below 256 the speed loop can swing */
#define LONGEST 100000000L /* 0.1 um: ten metres that are missing; 32 bits hold GAIN times it */

static void take_pulses(struct hall *hall, int32_t travel, uint32_t edge_at)
{
	uint32_t dt = edge_at - hall->edge_at;
	if (hall->rests || dt > HALL_TIMEOUT_US)
		dt = HALL_TIMEOUT_US; /* more is a rest, not a slow wheel */
	dt = dt ? dt : 1;
	/* um/us = m/s */
	int32_t mean = clamp(travel * 1000L / (int32_t)dt, -FASTEST, FASTEST);
	uint32_t middle = edge_at - dt / 2;
	uint32_t apart = (middle - hall->middle) / 1000; /* ms */
	int32_t acceleration = 0;
	if (!hall->rests && apart < HALL_TIMEOUT_US / 1000)
		acceleration = hall->acceleration +
			       ((mean - hall->mean) * 1000 - hall->acceleration * (int32_t)apart) /
				       SMOOTHING_MS;
	hall->acceleration = (int16_t)clamp(acceleration, -HARDEST, HARDEST);
	hall->mean = (int16_t)mean;
	hall->middle = middle;
	hall->edge_at = edge_at;
	hall->rests = false;
}

void hall_begin(struct hall *hall, int32_t pulse, int32_t count)
{
	*hall = (struct hall){ .count = count, .beyond = pulse / 2, .rests = true };
}

/* From the edge of the newest pulse before to that of the newest one, in pulses. */
static int32_t edges_passed(struct hall *hall, int32_t pulses)
{
	bool backward = pulses < 0;
	if (backward != hall->backward)
		pulses += backward ? 1 : -1; /* the first one is at the same edge, the other way */
	hall->backward = backward;
	return pulses;
}

int32_t hall_travel(struct hall *hall, int32_t pulse, int32_t count, uint32_t edge_at, uint32_t now)
{
	/* 2 m in a tick are no wheel any more, and 32 bits hold a thousand times as much */
	const int32_t most_pulses = 2000000L / pulse;
	int32_t pulses = clamp(count - hall->count, -most_pulses, most_pulses);
	int32_t travel = 0;
	int32_t before = hall->beyond;
	hall->count = count;
	if (pulses) {
		travel = pulse * edges_passed(hall, pulses);
		take_pulses(hall, travel, edge_at);
	}
	uint32_t since = now - hall->edge_at;
	if (since >= HALL_TIMEOUT_US)
		hall->rests = true;
	int32_t most = hall->rests          ? 0 :
		       pulses || since == 0 ? FASTEST :
					      pulse * 1000L / (int32_t)since;
	int32_t age = (int32_t)((now - hall->middle) / 100); /* 0.1 ms */
	int32_t speed = hall->mean;
	if (most)
		speed += hall->acceleration * age / 10000;
	hall->speed = (int16_t)clamp(speed, -most, most);
	if (pulses)
		hall->beyond = hall->speed * (int32_t)since / 1000;
	else
		hall->beyond += hall->speed * (TICK_US / 1000L);
	hall->beyond = clamp(hall->beyond, -pulse, pulse);
	return travel + hall->beyond - before;
}

int32_t motor_torque(struct motor *motor, const struct motor_limits *limits, int32_t setpoint,
		     int16_t speed, int32_t travel)
{
	const int32_t radius = limits->tyre_radius;
	/* the integral of the error is the way that is missing: counted, not summed up from speeds */
	motor->integral -= 10 * travel;
	int32_t rate = speed * 10000L / radius; /* mrad/s */
	int32_t error = setpoint * 100 / radius - rate;
	int32_t demand = GAIN * error + GAIN * motor->integral / radius;
	int32_t available = limits->power * 1000000L / (rate > 500 ? rate : 500);
	int32_t no_load = NO_LOAD_SLOPE * (NO_LOAD - rate);
	available = available < no_load ? available : no_load;
	available = available < limits->torque ? available : limits->torque;
	int32_t torque = demand < available ? demand : available;
	torque = torque > -limits->regenerative ? torque : -limits->regenerative;
	/* a set-point of 0.01 mm/s is 0.1 um in the coming 10 ms, 0.2 rad/s per N m are 2e-6 rad per
	 * mN m, and a radius of 0.1 mm has 1000 of these */
	int32_t back = (torque - demand) * (radius / 5) / 100;
	motor->integral = clamp(motor->integral + setpoint + back, -LONGEST, LONGEST);
	return torque;
}
