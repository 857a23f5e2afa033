/* What both PLCs share: session, state machine, watchdog, counters. No hardware inside: the same
 * code runs on the AVR, in the simulated AVR and on the host. One struct plc is one board. */
#ifndef PLC_H
#define PLC_H

#include <stdbool.h>

#include "board.h"
#include "frame.h"

struct plc {
	struct frame_decoder decoder;
	struct stats stats;
	struct board board;
	uint8_t setup[SIZE_SETUP]; /* of this session, as it came */
	uint32_t state_since;      /* us */
	uint32_t command_at;       /* us, of the last accepted command */
	uint32_t build_hash;
	uint16_t boot_count;
	uint16_t faults;
	uint8_t reset_cause;
	uint8_t state;
	uint8_t session;
	uint8_t tx_seq;
	uint8_t rx_seq;
	uint8_t command_seq;
	uint8_t commands_in_row; /* with enable = 1; saturates */
	uint8_t answered;        /* bytes since the last tick */
	uint8_t operation;       /* number of the newest */
	uint8_t operation_result;
	bool operated; /* in this session: operation and its result hold */
	bool set_up;   /* in this session: setup holds */
	bool rx_seq_known;
	bool commanded; /* command_at holds */
	bool enabled;
	bool limited;
	bool estop_pressed;
	bool alive; /* level of the output that says so */
	/* Takes a frame to the line; false where the line is full. */
	bool (*transmit)(void *context, const uint8_t *wire, uint8_t length);
	void *context;
};

void plc_reset(struct plc *plc, uint8_t cause, uint16_t boot_count);
void plc_receive(struct plc *plc, uint8_t byte, uint32_t now);
/* One 10 ms control tick: inputs are in plc->board, outputs are left there. */
void plc_tick(struct plc *plc, uint32_t now);

/* for the boards */
void plc_send(struct plc *plc, uint8_t id, const void *payload, uint8_t length);
/* Sends what the host asked for; not more than ANSWER_BUDGET between two ticks. */
void plc_answer(struct plc *plc, uint8_t id, const void *payload, uint8_t length);
uint8_t plc_state_flags(const struct plc *plc);
uint8_t plc_command_age(const struct plc *plc, uint32_t now); /* 10 ms */

/* what the boards provide: steer.c, drive.c */
struct setup_field {
	uint16_t low;
	uint16_t high;
	uint16_t compiled; /* in force where SETUP has 0 */
};
extern const struct setup_field board_setup_fields[SIZE_SETUP / 2]; /* all of them are u16 */
void board_reset(struct plc *plc);
/* Whether values in force, each in its range, agree with each other. */
bool board_accepts(const void *values);
/* Does what changed values in force ask for; a board is not armed before new commands came. */
void board_set_up(struct plc *plc);
void board_begin_tick(struct plc *plc, uint32_t now);
/* Of an armed or stopping board. */
uint16_t board_find_fault(struct plc *plc, uint32_t now);
bool board_stopped(const struct plc *plc);
bool board_ready(const struct plc *plc);
void board_armed(struct plc *plc);
void board_disarmed(struct plc *plc, uint32_t now);
bool board_holds(const struct plc *plc);
/* Keeps a command's set-point; payload is whole. */
void board_take_command(struct plc *plc, const void *payload);
void board_control(struct plc *plc);
void board_send_state(struct plc *plc, uint32_t now);
void board_send_limits(struct plc *plc);

#if defined(BOARD_IS_STEER)
/* Length of the servo's pulse in 1/16 us, from the set-point in 1e-5 rad. */
uint16_t steer_pulse(int32_t setpoint);
#else
/* Before a tick: speed and travel from the pulse counter and the time of its newest pulse. */
void drive_measure(struct plc *plc, int32_t count, uint32_t edge_at, uint32_t now);
/* After a tick: the motor's torque until the next one. */
void drive_push(struct plc *plc);
int16_t drive_pwm(const struct board *board); /* per mille of MAX_TORQUE */
/* Timer counts of the motor's output, 0..PWM_TOP; 0 while the motor is off. */
uint16_t drive_throttle(const struct board *board);
#endif

static inline int32_t clamp(int32_t value, int32_t low, int32_t high)
{
	return value < low ? low : value > high ? high : value;
}

static inline int32_t slew(int32_t setpoint, int32_t target, int32_t change)
{
	return setpoint + clamp(target - setpoint, -change, change);
}

/* Of a range in SETUP; both are 0 where it is not used. */
static inline bool in_order(uint16_t low, uint16_t high)
{
	return low < high || (low == 0 && high == 0);
}

#endif
