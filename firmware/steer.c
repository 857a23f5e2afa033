/* The steer PLC: a slewed, limited set-point for the steering servo. */
#include "plc.h"

#include <string.h>

#define HOLDING_US (1000UL * HOLDING_MS)
#define TRACKING_US (1000UL * TRACKING_MS)
#define LARGEST_ERROR (10L * TRACKING_ERROR) /* 1e-5 rad */

const struct setup_field board_setup_fields[SIZE_SETUP / 2] = {
	{ 1, MAX_ANGLE, MAX_ANGLE },
	{ 1, MAX_RATE, MAX_RATE },
	{ 1, UINT16_MAX, 0 },
	{ 1, UINT16_MAX, 0 },
};

uint16_t steer_pulse(int32_t setpoint)
{
	const int32_t full = 10L * END_STOP;
	int32_t more = setpoint * (16L * SERVO_SPAN) + (setpoint < 0 ? -full : full) / 2;
	return (uint16_t)(16 * SERVO_CENTRE + more / full);
}

void board_reset(struct plc *plc)
{
	plc->board.adc = ADC_CENTRE;
}

bool board_accepts(const void *values)
{
	struct steer_setup wanted;
	memcpy(&wanted, values, sizeof wanted);
	return in_order(wanted.supply_low, wanted.supply_high);
}

void board_set_up(struct plc *plc)
{
	(void)plc;
}

void board_begin_tick(struct plc *plc, uint32_t now)
{
	struct board *board = &plc->board;
	if (board->holding && now - board->holding_since >= HOLDING_US)
		board->holding = false;
}

static bool wire_broken(const struct board *board)
{
	return board->adc < ADC_LOW || board->adc > ADC_HIGH;
}

uint16_t board_find_fault(struct plc *plc, uint32_t now)
{
	struct board *board = &plc->board;
	if (plc->state != PLC_STATE_ARMED)
		return 0;
	if (wire_broken(board))
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

bool board_stopped(const struct plc *plc)
{
	return !plc->board.holding;
}

bool board_ready(const struct plc *plc)
{
	return !wire_broken(&plc->board);
}

void board_armed(struct plc *plc)
{
	plc->board.setpoint = 10L * clamp(plc->board.angle, -END_STOP, END_STOP);
	plc->board.off_track = false;
	plc->board.holding = false;
}

void board_disarmed(struct plc *plc, uint32_t now)
{
	plc->board.holding = true;
	plc->board.holding_since = now;
}

bool board_holds(const struct plc *plc)
{
	return plc->board.holding;
}

void board_take_command(struct plc *plc, const void *payload)
{
	struct board *board = &plc->board;
	struct steer_command command;
	memcpy(&command, payload, sizeof command);
	const int16_t most = (int16_t)board->in_force.max_angle;
	const uint16_t fastest = board->in_force.max_rate;
	uint16_t rate = command.max_rate ? command.max_rate : fastest;
	board->target = (int16_t)clamp(command.angle, -most, most);
	board->rate_limit = rate < fastest ? rate : fastest;
	board->command_limited = board->target != command.angle || board->rate_limit != rate;
	if (command.flags & COMMAND_FLAG_STANDSTILL)
		board->holding = false;
}

void board_control(struct plc *plc)
{
	struct board *board = &plc->board;
	bool armed = plc->state == PLC_STATE_ARMED;
	board->servo_on = armed || board->holding;
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
		.watchdog = WATCHDOG_MS,
		.stale = STALE_TICKS,
		.end_stop = END_STOP,
		.adc_scale = ADC_SCALE,
	};
	memcpy(&limits, &plc->board.in_force, sizeof plc->board.in_force); /* its first fields */
	plc_answer(plc, ID_STEER_LIMITS, &limits, sizeof limits);
}
