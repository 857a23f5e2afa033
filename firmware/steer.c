/* The steer PLC: a slewed, limited set-point for the steering servo. */
#include "plc.h"

#include <string.h>

#define HOLDING_US (1000UL * HOLDING_MS)
#define TRACKING_US (1000UL * TRACKING_MS)
#define LARGEST_ERROR (10L * TRACKING_ERROR) /* 1e-5 rad */

uint16_t steer_pulse(int32_t setpoint)
{
	const int32_t full = 10L * MAX_ANGLE;
	int32_t more = setpoint * (16L * SERVO_SPAN) + (setpoint < 0 ? -full : full) / 2;
	return (uint16_t)(16 * SERVO_CENTRE + more / full);
}

static bool servo_on(const struct plc *plc)
{
	return plc->state == PLC_STATE_ARMED || plc->state == PLC_STATE_STOPPING;
}

void board_reset(struct plc *plc)
{
	plc->board.adc = ADC_CENTRE;
	plc->board.rate_limit = MAX_RATE;
}

uint16_t board_find_fault(struct plc *plc, uint32_t now)
{
	struct board *board = &plc->board;
	if (board->adc < ADC_LOW || board->adc > ADC_HIGH)
		return FAULT_SENSOR;
	int32_t error = board->setpoint - 10L * board->angle;
	if (error <= LARGEST_ERROR && error >= -LARGEST_ERROR) {
		board->off_track = false;
	} else if (!board->off_track) {
		board->off_track = true;
		board->off_track_since = now;
	} else if (now - board->off_track_since >= TRACKING_US) {
		return FAULT_TRACKING;
	}
	return 0;
}

bool board_stopped(const struct plc *plc, uint32_t now)
{
	return now - plc->state_since >= HOLDING_US;
}

bool board_ready(const struct plc *plc)
{
	(void)plc;
	return true;
}

void board_armed(struct plc *plc)
{
	plc->board.setpoint = 10L * plc->board.angle;
	plc->board.off_track = false;
}

void board_take_command(struct plc *plc, const void *payload)
{
	struct board *board = &plc->board;
	struct steer_command command;
	memcpy(&command, payload, sizeof command);
	uint16_t rate = command.max_rate ? command.max_rate : MAX_RATE;
	board->target = (int16_t)clamp(command.angle, -MAX_ANGLE, MAX_ANGLE);
	board->rate_limit = rate < MAX_RATE ? rate : MAX_RATE;
	board->command_limited = board->target != command.angle || board->rate_limit != rate;
}

void board_control(struct plc *plc)
{
	struct board *board = &plc->board;
	bool armed = plc->state == PLC_STATE_ARMED;
	plc->limited = board->command_limited && armed;
	board->servo_on = servo_on(plc);
	if (armed)
		board->setpoint = slew(board->setpoint, 10L * board->target, board->rate_limit);
	else if (!board->servo_on)
		board->setpoint = 10L * board->angle;
}

void board_send_state(struct plc *plc, uint32_t now)
{
	const struct board *board = &plc->board;
	struct steer_state state = {
		now,
		plc->state,
		plc_state_flags(plc),
		plc->faults,
		board->angle,
		(int16_t)((board->setpoint + (board->setpoint < 0 ? -5 : 5)) / 10),
		board->rate,
		board->servo_on ? (steer_pulse(board->setpoint) + 8) / 16 : 0,
		board->adc,
		board->supply,
		plc->command_seq,
		plc_command_age(plc, now),
	};
	plc_send(plc, ID_STEER_STATE, &state, sizeof state);
}

void board_send_limits(struct plc *plc)
{
	struct steer_limits limits = {
		-MAX_ANGLE, MAX_ANGLE, MAX_RATE, WATCHDOG_MS, STALE_TICKS, ADC_SCALE, 0, 0,
	};
	plc_send(plc, ID_STEER_LIMITS, &limits, sizeof limits);
}
