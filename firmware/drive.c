/* The drive PLC: a slewed, limited speed set-point, gear and brake, the motor's torque. */
#include "plc.h"

#include <string.h>

#define STOPPING_US (1000UL * STOPPING_MS)
#define FULL_MV 5000L /* of an output that is always on */
#define EXCESS (100L * STOPPING_EXCESS) /* 0.01 mm/s */
#define RUNAWAY (100L * RUNAWAY_MARGIN)

const struct setup_field board_setup_fields[SIZE_SETUP / 2] = {
	{ 1, MAX_SPEED, MAX_SPEED },
	{ 1, MAX_ACCELERATION, MAX_ACCELERATION },
	{ HALL_PULSE_MIN, HALL_PULSE_MAX, HALL_PULSE },
	{ TYRE_RADIUS_MIN, TYRE_RADIUS_MAX, TYRE_RADIUS },
	{ 1, MAX_TORQUE / 10, MAX_TORQUE / 10 },
	{ 1, MAX_REGENERATIVE_TORQUE / 10, MAX_REGENERATIVE_TORQUE / 10 },
	{ 1, MAX_POWER / 1000, MAX_POWER / 1000 },
	{ MASS_MIN, MASS_MAX, MASS_LOW },
	{ MASS_MIN, MASS_MAX, MASS_HIGH },
	{ 1, UINT16_MAX, 0 },
	{ 1, UINT16_MAX, 0 },
	{ 1, THROTTLE_MAX, 0 },
	{ 1, THROTTLE_MAX, 0 },
};

static int32_t magnitude(int32_t value)
{
	return value < 0 ? -value : value;
}

static int32_t larger(int32_t one, int32_t other)
{
	return one > other ? one : other;
}

static bool at_rest(const struct plc *plc)
{
	return magnitude(plc->board.speed) < AT_REST;
}

void board_reset(struct plc *plc)
{
	plc->board.brake = MAX_BRAKE;
}

bool board_accepts(const void *values)
{
	struct drive_setup wanted;
	memcpy(&wanted, values, sizeof wanted);
	return wanted.mass_low <= wanted.mass_high &&
	       in_order(wanted.supply_low, wanted.supply_high) &&
	       in_order(wanted.throttle_low, wanted.throttle_high);
}

void board_set_up(struct plc *plc)
{
	struct board *board = &plc->board;
	const struct drive_setup *in_force = &board->in_force;
	wheel_set_up(&board->wheel, 1e-6f * in_force->pulse, 1e-4f * in_force->tyre_radius,
		     0.1f * in_force->mass_low, 0.1f * in_force->mass_high);
}

void drive_measure(struct plc *plc, int32_t count, uint32_t edge_at, uint32_t now)
{
	struct board *board = &plc->board;
	if (plc->state == PLC_STATE_BOOT)
		hall_begin(&board->hall, board->in_force.pulse, count);
	board->hall_count = count;
	board->travel = hall_travel(&board->hall, board->in_force.pulse, count, edge_at, now);
	board->speed = board->hall.speed;
}

void drive_push(struct plc *plc)
{
	struct board *board = &plc->board;
	if (!board->motor_on) {
		board->motor.integral = 0;
		board->torque = 0;
		return;
	}
	const struct motor_limits limits = {
		board->in_force.tyre_radius,
		10L * board->in_force.torque,
		10L * board->in_force.regenerative_torque,
		board->in_force.power,
	};
	if (board->gear == GEAR_REVERSE)
		board->torque = -motor_torque(&board->motor, &limits, -board->setpoint,
					      (int16_t)-board->speed, -board->travel);
	else
		board->torque = motor_torque(&board->motor, &limits, board->setpoint, board->speed,
					     board->travel);
}

int16_t drive_pwm(const struct board *board)
{
	int32_t more = board->torque < 0 ? -MAX_TORQUE / 2 : MAX_TORQUE / 2;
	if (!board->motor_on)
		return 0;
	return (int16_t)clamp((board->torque * 1000 + more) / MAX_TORQUE, -1000, 1000);
}

uint16_t drive_throttle(const struct board *board)
{
	const struct drive_setup *in_force = &board->in_force;
	int32_t low = (int32_t)in_force->throttle_low * PWM_TOP / FULL_MV;
	int32_t high = in_force->throttle_high ?
		(int32_t)in_force->throttle_high * PWM_TOP / FULL_MV : PWM_TOP;
	if (!board->motor_on)
		return 0;
	return (uint16_t)(low + (high - low) * magnitude(board->torque) / MAX_TORQUE);
}

/* Neither low nor high: resistors at the sensor keep both levels away from ground and supply. */
static bool line_wrong(uint16_t adc)
{
	return adc < LINE_LOW_MIN || adc > LINE_HIGH_MAX ||
	       (adc > LINE_LOW_MAX && adc < LINE_HIGH_MIN);
}

static bool line_broken(const struct board *board)
{
	return board->line_ticks == LINE_TICKS;
}

/* In the last tick the motor alone acted on the wheel. */
static bool pushes(const struct board *board)
{
	return board->motor_on && !board->brake;
}

void board_begin_tick(struct plc *plc, uint32_t now)
{
	struct board *board = &plc->board;
	(void)now;
	if (!line_wrong(board->hall_adc) && !line_wrong(board->direction_adc))
		board->line_ticks = 0;
	else if (!line_broken(board))
		board->line_ticks++;
	if (line_broken(board))
		plc->faults |= FAULT_HALL_LINE;
	board->pulses = board->hall_count - board->last_count;
	board->last_count = board->hall_count;
	if (!pushes(board))
		wheel_rest(&board->wheel, board->pulses);
	board->resting = !pushes(board) && !wheel_rests(&board->wheel);
}

static int32_t target_of(const struct board *board)
{
	if (board->braking || board->resting || board->gear != board->commanded_gear ||
	    board->gear == GEAR_NEUTRAL)
		return 0;
	return (board->gear == GEAR_REVERSE ? -100L : 100L) * board->target;
}

/* Gains speed above what is wanted although the motor brakes, which then does not hold it. A set-point
 * may fall faster than the vehicle, which is then above it but does not gain. A controller overshoots
 * by a third of a second of the acceleration with which it arrives: a slope alone does not give more
 * than OVERSHOOT. */
static bool runs_away(struct board *board)
{
	bool pushes = board->gear == GEAR_REVERSE ? board->torque < 0 : board->torque > 0;
	int32_t speed = 100L * magnitude(board->speed);
	int32_t wanted = larger(magnitude(board->setpoint), magnitude(target_of(board)));
	int32_t overshoot = larger(100L * OVERSHOOT, speed - board->lagging);
	board->lagging += (speed - board->lagging) / OVERSHOOT_TICKS;
	int32_t most = larger(pushes ? wanted + overshoot : wanted, board->ceiling);
	board->ceiling = larger(speed < most ? speed : most, wanted);
	return speed > board->ceiling + RUNAWAY;
}

/* Outputs are still those of the last tick. */
static bool wheel_wrong(struct board *board)
{
	if (!pushes(board))
		return false;
	int8_t sign = board->gear == GEAR_REVERSE ? -1 : 1;
	return wheel_fails(&board->wheel, 1e-3f * (float)(sign * board->torque),
			   sign * board->pulses, 1e-3f * (float)(sign * board->speed),
			   1e-5f * (float)(sign * board->setpoint));
}

uint16_t board_find_fault(struct plc *plc, uint32_t now)
{
	struct board *board = &plc->board;
	if (line_broken(board))
		return FAULT_HALL_LINE;
	if (magnitude(board->speed) > (int32_t)board->in_force.max_speed + OVERSPEED_MARGIN)
		return FAULT_OVERSPEED;
	if (wheel_wrong(board))
		return FAULT_PULSES;
	if (plc->state == PLC_STATE_ARMED && runs_away(board))
		return FAULT_OVERSPEED;
	if (plc->state == PLC_STATE_STOPPING && now - plc->state_since >= STOPPING_US &&
	    !board_stopped(plc))
		return FAULT_STOP_TIMEOUT;
	return 0;
}

bool board_stopped(const struct plc *plc)
{
	return at_rest(plc) && plc->board.setpoint == 0;
}

bool board_ready(const struct plc *plc)
{
	return plc->board.target == 0 && magnitude(plc->board.speed) < ARMING_SPEED;
}

void board_armed(struct plc *plc)
{
	plc->board.setpoint = 0;
	plc->board.ceiling = plc->board.lagging = 0;
	plc->board.braking = plc->board.holding = false;
}

/* A stop does not push: it goes on from the speed, where the vehicle is slower than wanted. */
static void begin_at_speed(struct board *board)
{
	board->setpoint = clamp(100L * board->speed, board->setpoint < 0 ? board->setpoint : 0,
				board->setpoint > 0 ? board->setpoint : 0);
}

void board_disarmed(struct plc *plc, uint32_t now)
{
	struct board *board = &plc->board;
	(void)now;
	board->braking = board->holding = false;
	begin_at_speed(board);
}

bool board_holds(const struct plc *plc)
{
	return plc->board.holding;
}

void board_take_command(struct plc *plc, const void *payload)
{
	struct board *board = &plc->board;
	struct drive_command command;
	memcpy(&command, payload, sizeof command);
	const uint16_t most = board->in_force.max_acceleration;
	uint16_t acceleration = command.max_acceleration ? command.max_acceleration : most;
	bool known_gear = command.gear <= GEAR_REVERSE;
	board->target = (int16_t)clamp(command.speed, 0, board->in_force.max_speed);
	board->acceleration_limit = acceleration < most ? acceleration : most;
	board->commanded_brake = command.brake < MAX_BRAKE ? command.brake : MAX_BRAKE;
	board->commanded_gear = known_gear ? command.gear : GEAR_NEUTRAL;
	board->command_limited = board->target != command.speed ||
				 board->acceleration_limit != acceleration ||
				 board->commanded_brake != command.brake || !known_gear;
}

/* Ramps down; the brake joins where the vehicle cannot follow the ramp or the ramp is over, and stays. */
static void stop(struct board *board, uint16_t deceleration)
{
	board->setpoint = slew(board->setpoint, 0, larger(deceleration, STOPPING_DECELERATION));
	if (board->setpoint == 0 || magnitude(100L * board->speed - board->setpoint) > EXCESS)
		board->brake = (uint8_t)clamp(board->brake + STOPPING_BRAKE_RATE, 0, MAX_BRAKE);
}

/* Follows its command, and holds where that is to stand. A commanded brake stops the vehicle without
 * the motor: against a brake, torque and pulses cannot be compared, and the comparison begins at rest. */
static void follow(struct plc *plc)
{
	struct board *board = &plc->board;
	bool stands = at_rest(plc) && board->setpoint == 0;
	board->braking = board->commanded_brake || (board->braking && !stands);
	if (board->commanded_gear != board->gear && stands && wheel_rests(&board->wheel)) {
		board->gear = board->commanded_gear;
		/* both look in the direction of the gear: what holds on a slope goes on */
		board->motor.integral = -board->motor.integral;
		wheel_restart(&board->wheel);
	}
	int32_t target = target_of(board);
	/* the brake may slip: what holds goes on until there is a target */
	board->holding = target == 0 && (stands || board->holding);
	if (board->holding || !board->braking) {
		board->setpoint = slew(board->setpoint, target, board->acceleration_limit);
		board->brake = board->holding ? MAX_BRAKE : 0;
	} else {
		begin_at_speed(board);
		stop(board, board->acceleration_limit);
		board->brake = (uint8_t)larger(board->brake, board->commanded_brake);
	}
}

void board_control(struct plc *plc)
{
	struct board *board = &plc->board;
	bool armed = plc->state == PLC_STATE_ARMED;
	bool stopping = plc->state == PLC_STATE_STOPPING;
	if (armed) {
		follow(plc);
	} else if (stopping) {
		stop(board, board->in_force.max_acceleration);
	} else {
		board->setpoint = 0;
		board->brake = MAX_BRAKE;
		board->gear = GEAR_NEUTRAL;
	}
	board->motor_on = (armed || stopping) && board->gear != GEAR_NEUTRAL && !board->holding &&
			  !board->braking;
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
		drive_pwm(board),
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
	struct drive_limits limits = { .watchdog = WATCHDOG_MS, .stale = STALE_TICKS };
	memcpy(&limits, &plc->board.in_force, sizeof plc->board.in_force); /* its first fields */
	plc_answer(plc, ID_DRIVE_LIMITS, &limits, sizeof limits);
}
