#include "motor.h"

#include "plc.h"

#define HALL_TIMEOUT_US 300000UL
#define TYRE_RADIUS 335L       /* mm */
#define MIN_TORQUE (-15000L)   /* mN m, regenerative */
#define MAX_POWER 250000L      /* mW */
#define NO_LOAD 15500L         /* mrad/s */
#define NO_LOAD_SLOPE 9L       /* mN m per mrad/s */
#define GAIN 20L               /* mN m per mrad/s, and per mrad */

int16_t hall_speed(struct hall *hall, int32_t count, uint32_t edge_at, uint32_t now)
{
	int32_t pulses = count - hall->count;
	if (pulses) {
		uint32_t dt = edge_at - hall->edge_at;
		/* um/us = m/s; pulses per tick are few, so 32 bits hold the product in mm/s */
		int32_t speed = (int32_t)(pulses * (HALL_PULSE * 1000L) / (int32_t)(dt ? dt : 1));
		hall->speed = (int16_t)clamp(speed, -32767, 32767);
		hall->count = count;
		hall->edge_at = edge_at;
	} else {
		uint32_t since = now - hall->edge_at;
		int16_t most = since > HALL_TIMEOUT_US ? 0 :
			       (int16_t)clamp(HALL_PULSE * 1000L / (int32_t)(since ? since : 1), 0,
					      32767);
		hall->speed = (int16_t)clamp(hall->speed, -most, most);
	}
	return hall->speed;
}

int32_t motor_torque(struct motor *motor, int32_t setpoint, int16_t speed)
{
	int32_t wanted = setpoint * 10 / TYRE_RADIUS; /* mrad/s from 0.01 mm/s */
	int32_t rate = speed * 1000L / TYRE_RADIUS;
	int32_t error = wanted - rate;
	int32_t demand = GAIN * error + GAIN * motor->integral / 1000;
	int32_t available = MAX_POWER * 1000 / (rate > 500 ? rate : 500);
	int32_t no_load = NO_LOAD_SLOPE * (NO_LOAD - rate);
	available = available < no_load ? available : no_load;
	available = available < MAX_TORQUE ? available : MAX_TORQUE;
	int32_t torque = demand < available ? demand : available;
	torque = torque > MIN_TORQUE ? torque : MIN_TORQUE;
	/* d(integral)/dt = error + 0.2 (torque - demand), in urad per 10 ms from mrad/s */
	motor->integral += 10 * (error + (torque - demand) / 5);
	return torque;
}
