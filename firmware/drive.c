/* The drive PLC: a slewed, limited speed set-point, gear and brake. */
#include "plc.h"

#include <string.h>

#define STALL_SETPOINT (100L * STALL_SPEED) /* 0.01 mm/s */
#define STALL_US (1000UL * STALL_MS)

static bool at_rest(const struct plc *plc)
{
	return plc->board.speed < AT_REST && plc->board.speed > -AT_REST;
}

void board_reset(struct plc *plc)
{
	plc->board.acceleration_limit = MAX_ACCELERATION;
	plc->board.brake = MAX_BRAKE;
}

uint16_t board_find_fault(struct plc *plc, uint32_t now)
{
	struct board *board = &plc->board;
	if (board->speed > OVERSPEED || board->speed < -OVERSPEED)
		return FAULT_OVERSPEED;
	bool pulling = board->setpoint > STALL_SETPOINT || board->setpoint < -STALL_SETPOINT;
	if (!(at_rest(plc) && pulling)) {
		board->stalled = false;
	} else if (!board->stalled) {
		board->stalled = true;
		board->stalled_since = now;
	} else if (now - board->stalled_since >= STALL_US) {
		return FAULT_STALL;
	}
	return 0;
}

bool board_stopped(const struct plc *plc, uint32_t now)
{
	(void)now;
	return at_rest(plc) && plc->board.setpoint == 0;
}

bool board_ready(const struct plc *plc)
{
	return plc->board.target == 0;
}

void board_armed(struct plc *plc)
{
	plc->board.setpoint = 0;
	plc->board.stalled = false;
}

void board_take_command(struct plc *plc, const void *payload)
{
	struct board *board = &plc->board;
	struct drive_command command;
	memcpy(&command, payload, sizeof command);
	uint16_t acceleration =
		command.max_acceleration ? command.max_acceleration : MAX_ACCELERATION;
	bool known_gear = command.gear <= GEAR_REVERSE;
	board->target = (int16_t)clamp(command.speed, 0, MAX_SPEED);
	board->acceleration_limit =
		acceleration < MAX_ACCELERATION ? acceleration : MAX_ACCELERATION;
	board->commanded_brake = command.brake < MAX_BRAKE ? command.brake : MAX_BRAKE;
	board->commanded_gear = known_gear ? command.gear : GEAR_NEUTRAL;
	board->command_limited = board->target != command.speed ||
				 board->acceleration_limit != acceleration ||
				 board->commanded_brake != command.brake || !known_gear;
}

static int32_t target_of(const struct board *board)
{
	if (board->gear != board->commanded_gear || board->gear == GEAR_NEUTRAL)
		return 0;
	return (board->gear == GEAR_REVERSE ? -100L : 100L) * board->target;
}

void board_control(struct plc *plc)
{
	struct board *board = &plc->board;
	bool armed = plc->state == PLC_STATE_ARMED;
	bool stopping = plc->state == PLC_STATE_STOPPING;
	plc->limited = board->command_limited && armed;
	if (armed) {
		board->brake = board->commanded_brake;
		if (board->commanded_gear != board->gear && at_rest(plc) && board->setpoint == 0)
			board->gear = board->commanded_gear;
		board->setpoint =
			slew(board->setpoint, target_of(board), board->acceleration_limit);
	} else if (stopping) {
		board->setpoint = slew(board->setpoint, 0, MAX_ACCELERATION);
	} else {
		board->setpoint = 0;
		board->brake = MAX_BRAKE;
		board->gear = GEAR_NEUTRAL;
	}
	board->motor_on = (armed || stopping) && board->gear != GEAR_NEUTRAL;
}

void board_send_state(struct plc *plc, uint32_t now)
{
	const struct board *board = &plc->board;
	struct drive_state state = {
		now,
		plc->state,
		plc_state_flags(plc),
		plc->faults,
		board->speed,
		(int16_t)((board->setpoint + (board->setpoint < 0 ? -50 : 50)) / 100),
		board->hall_count,
		board->motor_on ? board->pwm : 0,
		board->current,
		board->supply,
		board->gear,
		board->brake,
		plc->command_seq,
		plc_command_age(plc, now),
	};
	plc_send(plc, ID_DRIVE_STATE, &state, sizeof state);
}

void board_send_limits(struct plc *plc)
{
	struct drive_limits limits = {
		0, MAX_SPEED, MAX_ACCELERATION, WATCHDOG_MS, STALE_TICKS, HALL_PULSE, 0, 0,
	};
	plc_send(plc, ID_DRIVE_LIMITS, &limits, sizeof limits);
}
