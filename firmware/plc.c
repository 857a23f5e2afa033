#include "plc.h"

#include <string.h>

#define WATCHDOG_US (WATCHDOG_MS * 1000UL)
#define VERSION_NODE (TBP_MAJOR << MAJOR_SHIFT | FROM_PLC | THIS_BOARD)
#define FIRMWARE_VERSION 2, 0, 0
#define NOT_RECEIVED 255 /* as the size of a payload */
#define SETUP_FIELDS (SIZE_SETUP / 2)
#define PASSING_FAULTS (FAULT_LIMIT | FAULT_SUPPLY) /* they do not latch */

static uint16_t echo_of(uint32_t t)
{
	return (uint16_t)(t >> ECHO_SHIFT);
}

static bool is(const struct plc *plc, uint8_t state)
{
	return plc->state == state;
}

static bool moving(const struct plc *plc)
{
	return is(plc, PLC_STATE_ARMED) || is(plc, PLC_STATE_STOPPING);
}

static uint8_t encode(struct plc *plc, uint8_t wire[FRAME_MAX_WIRE], uint8_t id,
		      const void *payload, uint8_t length)
{
	const uint8_t header[FRAME_HEADER] = { VERSION_NODE, id, plc->tx_seq++, plc->session };
	return frame_encode(wire, header, payload, length);
}

void plc_send(struct plc *plc, uint8_t id, const void *payload, uint8_t length)
{
	uint8_t wire[FRAME_MAX_WIRE];
	uint8_t used = encode(plc, wire, id, payload, length);
	if (!plc->transmit(plc->context, wire, used))
		plc->stats.tx_drop++;
}

void plc_answer(struct plc *plc, uint8_t id, const void *payload, uint8_t length)
{
	uint8_t wire[FRAME_MAX_WIRE];
	uint8_t used = encode(plc, wire, id, payload, length);
	bool fits = plc->answered + used <= ANSWER_BUDGET; /* the rest of the line is telemetry's */
	if (fits)
		plc->answered += used;
	if (!fits || !plc->transmit(plc->context, wire, used))
		plc->stats.tx_drop++;
}

static void enter(struct plc *plc, uint8_t state, uint32_t now, uint8_t code)
{
	struct event event = { now, code, (uint8_t)(plc->state << OLD_STATE_SHIFT | state),
			       plc->faults };
	if (is(plc, PLC_STATE_ARMED))
		board_disarmed(plc, now);
	plc->state = state;
	plc->state_since = now;
	plc_send(plc, ID_EVENT, &event, sizeof event);
}

static void change(struct plc *plc, uint8_t state, uint32_t now)
{
	enter(plc, state, now, EVENT_CODE_STATE_CHANGE);
}

static void estop(struct plc *plc, uint16_t fault, uint32_t now)
{
	plc->faults |= fault;
	if (!is(plc, PLC_STATE_ESTOP))
		change(plc, PLC_STATE_ESTOP, now);
}

/* ---- SETUP ---- */

static void put_in_force(struct plc *plc, const uint16_t values[SETUP_FIELDS])
{
	memcpy(&plc->board.in_force, values, SIZE_SETUP);
	plc->commands_in_row = 0; /* they were judged by other values */
	board_set_up(plc);
}

static void forget_setup(struct plc *plc)
{
	uint16_t compiled[SETUP_FIELDS];
	for (uint8_t i = 0; i < SETUP_FIELDS; i++)
		compiled[i] = board_setup_fields[i].compiled;
	plc->set_up = false;
	put_in_force(plc, compiled);
}

static uint8_t take_setup(struct plc *plc, const uint8_t *payload)
{
	if (!is(plc, PLC_STATE_SAFE))
		return RESULT_WRONG_STATE;
	if (plc->set_up)
		return memcmp(plc->setup, payload, SIZE_SETUP) == 0 ? RESULT_OK : RESULT_WRONG_STATE;
	uint16_t values[SETUP_FIELDS];
	memcpy(values, payload, SIZE_SETUP);
	for (uint8_t i = 0; i < SETUP_FIELDS; i++) {
		const struct setup_field *field = &board_setup_fields[i];
		if (values[i] == 0)
			values[i] = field->compiled;
		else if (values[i] < field->low || values[i] > field->high)
			return RESULT_OUT_OF_RANGE;
	}
	if (!board_accepts(values))
		return RESULT_OUT_OF_RANGE;
	memcpy(plc->setup, payload, SIZE_SETUP);
	plc->set_up = true;
	put_in_force(plc, values);
	return RESULT_OK;
}

void plc_reset(struct plc *plc, uint8_t cause, uint16_t boot_count)
{
	void *context = plc->context;
	bool (*transmit)(void *, const uint8_t *, uint8_t) = plc->transmit;
	memset(plc, 0, sizeof *plc);
	plc->context = context;
	plc->transmit = transmit;
	plc->reset_cause = cause;
	plc->boot_count = boot_count;
	plc->state = PLC_STATE_BOOT;
	if (cause == RESET_CAUSE_WATCHDOG)
		plc->faults = FAULT_WDT_RESET;
	board_reset(plc);
	forget_setup(plc);
}

uint8_t plc_state_flags(const struct plc *plc)
{
	return (plc->enabled ? STATE_FLAG_ENABLED : 0) |
	       (plc->estop_pressed ? STATE_FLAG_ESTOP_PRESSED : 0) |
	       (plc->limited ? STATE_FLAG_LIMITED : 0) | (plc->set_up ? STATE_FLAG_SET_UP : 0) |
	       (board_holds(plc) ? STATE_FLAG_HOLDING : 0);
}

uint8_t plc_command_age(const struct plc *plc, uint32_t now)
{
	uint32_t age = (now - plc->command_at) / TICK_US;
	return !plc->commanded || age > MAX_COMMAND_AGE ? MAX_COMMAND_AGE : (uint8_t)age;
}

/* ---- state machine ---- */

static bool command_fresh(const struct plc *plc, uint32_t now, uint32_t limit)
{
	return plc->commanded && now - plc->command_at < limit;
}

static bool supply_wrong(const struct plc *plc)
{
	const struct board *board = &plc->board;
	return (board->in_force.supply_low && board->supply < board->in_force.supply_low) ||
	       (board->in_force.supply_high && board->supply > board->in_force.supply_high);
}

static uint8_t clear(struct plc *plc, uint32_t now)
{
	if (moving(plc))
		return RESULT_WRONG_STATE;
	if (plc->estop_pressed)
		return RESULT_PRECONDITIONS;
	plc->faults &= PASSING_FAULTS;
	if (!is(plc, PLC_STATE_SAFE))
		change(plc, PLC_STATE_SAFE, now);
	return RESULT_OK;
}

static uint8_t arm(struct plc *plc, uint32_t now)
{
	if (is(plc, PLC_STATE_ARMED))
		return RESULT_OK;
	if (!is(plc, PLC_STATE_SAFE) || (plc->faults & ~PASSING_FAULTS))
		return RESULT_WRONG_STATE;
	if (!plc->set_up || plc->commands_in_row < ARMING_COMMANDS ||
	    !command_fresh(plc, now, WATCHDOG_US + 1) || !board_ready(plc) || supply_wrong(plc))
		return RESULT_PRECONDITIONS;
	board_armed(plc);
	change(plc, PLC_STATE_ARMED, now);
	return RESULT_OK;
}

static bool stale(uint16_t echo, uint32_t now)
{
	return (uint16_t)(echo_of(now) - echo) > STALE_TICKS;
}

static uint8_t keep_result(struct plc *plc, uint8_t number, uint8_t result)
{
	plc->operated = true;
	plc->operation = number;
	plc->operation_result = result;
	return result;
}

/* Towards standstill: whatever number and echo say. */
static uint8_t take_away(struct plc *plc, const struct control *control, uint32_t now)
{
	if (control->op == OP_ESTOP)
		estop(plc, FAULT_ESTOP_HOST, now);
	else if (moving(plc))
		change(plc, PLC_STATE_SAFE, now);
	uint8_t step = control->number - plc->operation;
	if (!plc->operated || (step > 0 && step <= NEWEST_STEP))
		keep_result(plc, control->number, RESULT_OK);
	return RESULT_OK;
}

/* What sets a vehicle in motion acts once, and only if it is new and from now. */
static uint8_t give(struct plc *plc, const struct control *control, uint32_t now)
{
	uint8_t step = control->number - plc->operation;
	if (plc->operated && step == 0)
		return plc->operation_result;
	if (plc->operated && step > NEWEST_STEP)
		return RESULT_STALE;
	if (stale(control->echo, now)) {
		plc->stats.stale++;
		return RESULT_STALE;
	}
	return keep_result(plc, control->number,
			   control->op == OP_ARM ? arm(plc, now) : clear(plc, now));
}

static uint8_t operate(struct plc *plc, const struct control *control, uint32_t now)
{
	if ((control->inverted_op ^ control->op) != 0xFF || control->guard != CONTROL_GUARD)
		return RESULT_BAD_GUARD;
	switch (control->op) {
	case OP_ESTOP:
	case OP_DISARM:
		return take_away(plc, control, now);
	case OP_CLEAR:
	case OP_ARM:
		return give(plc, control, now);
	default:
		return RESULT_UNKNOWN_OP;
	}
}

/* ---- frames ---- */

/* Both commands begin with their flags and end with their echo. */
static void accept_command(struct plc *plc, uint8_t seq, const uint8_t *payload, uint32_t now)
{
	uint16_t echo;
	memcpy(&echo, payload + SIZE_COMMAND - sizeof echo, sizeof echo);
	if (stale(echo, now)) {
		plc->stats.stale++;
		plc->commands_in_row = 0;
		return;
	}
	board_take_command(plc, payload);
	uint8_t flags = payload[0];
	plc->command_seq = seq;
	plc->command_at = now;
	plc->commanded = true;
	plc->enabled = flags & COMMAND_FLAG_ENABLE;
	if (!plc->enabled)
		plc->commands_in_row = 0;
	else if (plc->commands_in_row < UINT8_MAX)
		plc->commands_in_row++;
	if (flags & COMMAND_FLAG_ESTOP)
		estop(plc, FAULT_ESTOP_HOST, now);
	else if (is(plc, PLC_STATE_ARMED) && !plc->enabled)
		change(plc, PLC_STATE_STOPPING, now);
}

static void greet(struct plc *plc, const uint8_t *header, const struct hello *hello, uint32_t now)
{
	if (hello->board != THIS_BOARD && hello->board != BOARD_ANY)
		return;
	if (moving(plc))
		change(plc, PLC_STATE_SAFE, now);
	plc->rx_seq = header[SEQ_BYTE];
	plc->rx_seq_known = true;
	plc->session = header[SESSION_BYTE];
	plc->commanded = plc->enabled = false;
	plc->operated = false;
	forget_setup(plc);
	struct hello_ack ack = {
		TBP_MINOR,	 THIS_BOARD,	  FIRMWARE_VERSION,
		plc->reset_cause, plc->boot_count, plc->build_hash, hello->nonce,
		CAPABILITY_HARDWARE_ESTOP | CAPABILITY_BOOT_COUNTER | CAPABILITY_SUPPLY_MEASURED,
		WATCHDOG_MS,
	};
	plc_answer(plc, ID_HELLO_ACK, &ack, sizeof ack);
}

static bool count_seq(struct plc *plc, uint8_t seq)
{
	uint8_t step = (uint8_t)(seq - plc->rx_seq);
	if (plc->rx_seq_known) {
		if (step == 0) {
			plc->stats.duplicate++;
			return false;
		}
		plc->stats.seq_gap += step - 1;
	}
	plc->rx_seq = seq;
	plc->rx_seq_known = true;
	return true;
}

/* Size of the payload of an id in the message table. */
static uint8_t payload_size(uint8_t id)
{
	switch (id) {
	case ID_HELLO:
		return SIZE_HELLO;
	case ID_PING:
		return SIZE_PING;
	case ID_CONTROL:
		return SIZE_CONTROL;
	case ID_LIMITS_REQUEST:
		return SIZE_LIMITS_REQUEST;
	case ID_STATS_REQUEST:
		return SIZE_STATS_REQUEST;
	case ID_COMMAND:
		return SIZE_COMMAND;
	case ID_SETUP:
		return SIZE_SETUP;
	default:
		return NOT_RECEIVED;
	}
}

static void acknowledge(struct plc *plc, uint8_t op, uint8_t seq, uint8_t result)
{
	struct ack ack = { op, seq, result, plc->state };
	plc_answer(plc, ID_ACK, &ack, sizeof ack);
}

static void handle(struct plc *plc, uint32_t now)
{
	const uint8_t *header = plc->decoder.data;
	const uint8_t *payload = header + FRAME_HEADER;
	uint8_t length = plc->decoder.raw_length - FRAME_HEADER - FRAME_CRC_SIZE;
	uint8_t id = header[ID_BYTE];
	uint8_t size = payload_size(id);
	uint8_t board = header[VERSION_NODE_BYTE] & BOARD_MASK;
	bool hello = id == ID_HELLO;

	if (header[VERSION_NODE_BYTE] >> MAJOR_SHIFT != TBP_MAJOR && !hello) {
		plc->stats.version++;
		return;
	}
	if (size == NOT_RECEIVED || header[VERSION_NODE_BYTE] & FROM_PLC ||
	    (board != THIS_BOARD && !(hello && board == BOARD_ANY))) {
		plc->stats.unknown++;
		return;
	}
	if (!hello && (plc->session == 0 || header[SESSION_BYTE] != plc->session)) {
		plc->stats.session++;
		return;
	}
	if (length < size) {
		plc->stats.length++;
		return;
	}
	plc->stats.ok++;
	if (is(plc, PLC_STATE_BOOT))
		return;
	if (hello) {
		struct hello message;
		memcpy(&message, payload, sizeof message);
		greet(plc, header, &message, now);
		return;
	}
	if (!count_seq(plc, header[SEQ_BYTE]))
		return;
	switch (id) {
	case ID_COMMAND:
		accept_command(plc, header[SEQ_BYTE], payload, now);
		break;
	case ID_CONTROL: {
		struct control control;
		memcpy(&control, payload, sizeof control);
		uint8_t result = operate(plc, &control, now);
		acknowledge(plc, control.op, header[SEQ_BYTE], result);
		break;
	}
	case ID_SETUP:
		acknowledge(plc, OP_SETUP, header[SEQ_BYTE], take_setup(plc, payload));
		break;
	case ID_PING: {
		struct pong pong = { 0, now, now };
		memcpy(&pong.token, payload, sizeof pong.token);
		plc_answer(plc, ID_PONG, &pong, sizeof pong);
		break;
	}
	case ID_LIMITS_REQUEST:
		board_send_limits(plc);
		break;
	case ID_STATS_REQUEST:
		plc_answer(plc, ID_STATS, &plc->stats, sizeof plc->stats);
		break;
	}
}

void plc_receive(struct plc *plc, uint8_t byte, uint32_t now)
{
	switch (frame_feed(&plc->decoder, byte)) {
	case FRAME_NONE:
		break;
	case FRAME_OK:
		handle(plc, now);
		break;
	case FRAME_LENGTH:
		plc->stats.length++;
		break;
	case FRAME_COBS:
		plc->stats.cobs++;
		break;
	case FRAME_CRC:
		plc->stats.crc++;
		break;
	}
}

/* ---- tick ---- */

static void check_watchdog(struct plc *plc, uint32_t now)
{
	if (command_fresh(plc, now, WATCHDOG_US))
		return;
	if (plc_command_age(plc, now) == MAX_COMMAND_AGE)
		plc->commanded = false; /* the clock's wrap must not make it young again */
	plc->commands_in_row = 0;
	if (is(plc, PLC_STATE_ARMED)) {
		plc->faults |= FAULT_CMD_TIMEOUT;
		plc->stats.watchdog_trips++;
		change(plc, PLC_STATE_STOPPING, now);
	}
}

static void show(struct plc *plc, uint16_t fault, bool is_set)
{
	if (is_set)
		plc->faults |= fault;
	else
		plc->faults &= (uint16_t)~fault;
}

void plc_tick(struct plc *plc, uint32_t now)
{
	static const uint8_t delimiter = 0;
	plc->estop_pressed = plc->board.estop_input;
	if (is(plc, PLC_STATE_BOOT)) {
		/* ends a frame that the reset cut off */
		plc->transmit(plc->context, &delimiter, 1);
		enter(plc, PLC_STATE_SAFE, now, EVENT_CODE_BOOT);
	}
	board_begin_tick(plc, now);
	if (plc->estop_pressed)
		estop(plc, FAULT_ESTOP_HW, now);
	check_watchdog(plc, now);
	if (moving(plc)) {
		uint16_t fault = board_find_fault(plc, now);
		if (fault) {
			plc->faults |= fault;
			change(plc, PLC_STATE_FAULT, now);
		}
	}
	if (is(plc, PLC_STATE_STOPPING) && board_stopped(plc))
		change(plc, PLC_STATE_SAFE, now);
	board_control(plc);
	plc->limited = plc->board.command_limited && command_fresh(plc, now, WATCHDOG_US);
	show(plc, FAULT_LIMIT, plc->limited);
	show(plc, FAULT_SUPPLY, supply_wrong(plc));
	plc->alive = moving(plc) && !plc->alive;
	board_send_state(plc, now);
	plc->answered = 0;
}
