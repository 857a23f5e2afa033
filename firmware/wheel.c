#include "wheel.h"

#include "messages.h"

#define TICK (1e-6f * TICK_US)
#define TICKS(seconds) ((uint16_t)((seconds) / TICK + 0.5f))
#define REST_TICKS TICKS(0.3f)   /* without pulses: the speed between two is not known */
#define WINDOW_TICKS TICKS(0.4f) /* over which the slope is estimated from speeds */
#define SPEED_ERROR 0.05f        /* m/s of a measured speed */
#define SLACK 0.05f              /* m/s^2 by which the slope may change */

static float within(float value, float low, float high)
{
	return value < low ? low : value > high ? high : value;
}

static float magnitude(float value)
{
	return value < 0.0f ? -value : value;
}

static void count_tick(uint16_t *ticks)
{
	if (*ticks < UINT16_MAX)
		++*ticks;
}

/* Begins anew at a known speed. */
static void anchor(struct wheel *wheel, float speed)
{
	wheel->speed = speed;
	wheel->ticks = 0;
	wheel->count = 0;
	wheel->slow_gain = wheel->slow_travel = 0.0f;
	wheel->fast_gain = wheel->fast_travel = 0.0f;
}

void wheel_restart(struct wheel *wheel)
{
	wheel->torque = 0.0f;
	wheel->low = -RESISTANCE;
	wheel->high = RESISTANCE;
	wheel->speed_error = 0.0f; /* the brake held the wheel */
	wheel->last = 0;
	wheel->silence = REST_TICKS;
	wheel->window = 0;
	wheel->window_gain = wheel->window_speed = 0.0f;
	anchor(wheel, 0.0f);
}

/* Since a pulse there has been none. */
static void wait_for_pulse(struct wheel *wheel)
{
	wheel->wanted = 0.0f;
	wheel->waiting = 0;
}

void wheel_rest(struct wheel *wheel, int32_t pulses)
{
	count_tick(&wheel->rested);
	if (pulses)
		wait_for_pulse(wheel);
	wheel_restart(wheel);
}

bool wheel_rests(const struct wheel *wheel)
{
	return wheel->wanted < DOUBT_PULSES * wheel->pulse ||
	       wheel->rested >= TICKS(RESTING_TIME);
}

void wheel_set_up(struct wheel *wheel, float pulse, float radius, float mass_low, float mass_high)
{
	wheel->pulse = pulse;
	wheel->light = mass_low * radius;
	wheel->heavy = mass_high * radius;
	wheel->rested = 0;
	wait_for_pulse(wheel);
	wheel_restart(wheel);
}

/* Compares a speed between two pulses with the slowest that fits, and goes on from it. */
static bool speed_fails(struct wheel *wheel, float speed)
{
	float time = TICK * wheel->ticks;
	float slowest = wheel->speed + wheel->slow_gain + (wheel->low - 0.3f) * time - 0.01f;
	bool fails = speed < slowest - 0.2f - 0.1f * magnitude(speed);
	speed = speed > slowest ? speed : slowest;
	if (wheel->window >= WINDOW_TICKS) {
		float window = TICK * wheel->window;
		float gain = wheel->window_gain / window;
		float slope = (speed - wheel->window_speed) / window - gain;
		float error = 0.12f + 0.12f * magnitude(gain);
		wheel->low = within(slope - error, -RESISTANCE, RESISTANCE);
		wheel->high = within(slope + error, -RESISTANCE, RESISTANCE);
		wheel->window = 0;
		wheel->window_gain = 0.0f;
		wheel->window_speed = speed;
	}
	wheel->speed_error = SPEED_ERROR;
	anchor(wheel, speed);
	return fails;
}

bool wheel_fails(struct wheel *wheel, float torque, int32_t pulses, float speed, float setpoint)
{
	wheel->torque += (torque - wheel->torque) * (TICK / (TICK + TORQUE_LAG));
	bool pushes = wheel->torque > 0.0f;
	float slow = TICK * wheel->torque / (pushes ? wheel->heavy : wheel->light);
	float fast = TICK * wheel->torque / (pushes ? wheel->light : wheel->heavy);
	count_tick(&wheel->ticks);
	count_tick(&wheel->window);
	count_tick(&wheel->silence);
	wheel->rested = 0;
	wheel->wanted += TICK * setpoint;
	if (setpoint >= NO_PULSE_SPEED)
		count_tick(&wheel->waiting);
	wheel->slow_gain += slow;
	wheel->fast_gain += fast;
	wheel->slow_travel += (wheel->speed + wheel->slow_gain) * TICK;
	wheel->fast_travel += (wheel->speed + wheel->fast_gain) * TICK;
	wheel->window_gain += slow;
	wheel->count += pulses;

	float time = TICK * wheel->ticks;
	float per_half_square = 2.0f / (time * time);
	float margin = PULSE_MARGIN * wheel->pulse + wheel->speed_error * time;
	float travel = (float)wheel->count * wheel->pulse;
	float high = (travel + margin - wheel->slow_travel) * per_half_square;
	float low = (travel - margin - wheel->fast_travel) * per_half_square;
	wheel->high = high < wheel->high ? high : wheel->high;
	wheel->low = low > wheel->low ? low : wheel->low;
	bool fails = wheel->low > wheel->high + SLACK || speed < -AGAINST_GEAR ||
		     (wheel->silence > TICKS(NO_PULSE_TIME) && setpoint >= NO_PULSE_SPEED);
	if (wheel->waiting > TICKS(NO_PULSE_TIME)) {
		fails = true;
		wheel->waiting = 0; /* after CLEAR the wheel may turn again */
	}
	if (pulses) {
		bool known = wheel->silence < REST_TICKS &&
			     (pulses > 0 ? wheel->last > 0 : wheel->last < 0);
		if (known && speed_fails(wheel, speed))
			fails = true;
		wheel->last = pulses;
		wheel->silence = 0;
		wait_for_pulse(wheel);
	}
	return fails;
}
