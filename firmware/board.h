/* The board that this build is for: inputs, outputs and what lies between. */
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "messages.h"
#include "motor.h"
#include "wheel.h"

#if defined(BOARD_IS_STEER)
#define THIS_BOARD BOARD_STEER
#define ID_COMMAND ID_STEER_COMMAND
#define SIZE_COMMAND SIZE_STEER_COMMAND
#define ID_SETUP ID_STEER_SETUP
#define SIZE_SETUP SIZE_STEER_SETUP
struct board {
	struct steer_setup in_force; /* no field is 0 but those of the supply */
	/* inputs */
	int16_t angle;   /* 1e-4 rad */
	int16_t rate;    /* 1e-3 rad/s */
	uint16_t adc;    /* counts */
	uint16_t supply; /* mV */
	bool estop_input;
	/* outputs */
	bool servo_on;
	int32_t setpoint; /* 1e-5 rad: one tick at 1e-3 rad/s */
	/* between */
	int16_t target;      /* 1e-4 rad */
	uint16_t rate_limit; /* 1e-3 rad/s */
	bool command_limited;
	bool off_track;
	uint32_t off_track_since; /* us */
	bool holding;             /* not armed any more, the servo still on */
	uint32_t holding_since;   /* us */
};
#elif defined(BOARD_IS_DRIVE)
#define THIS_BOARD BOARD_DRIVE
#define ID_COMMAND ID_DRIVE_COMMAND
#define SIZE_COMMAND SIZE_DRIVE_COMMAND
#define ID_SETUP ID_DRIVE_SETUP
#define SIZE_SETUP SIZE_DRIVE_SETUP
struct board {
	struct drive_setup in_force; /* no field is 0 but those of supply and throttle */
	/* inputs */
	int16_t speed;      /* mm/s */
	int32_t hall_count; /* pulses */
	uint16_t hall_adc;      /* counts, of the line's level */
	uint16_t direction_adc; /* counts */
	uint16_t current;   /* mA */
	uint16_t supply;    /* mV */
	bool estop_input;
	/* outputs */
	bool motor_on;
	int32_t torque;   /* mN m, forward positive; until the next tick's is known, the last one's */
	int32_t setpoint; /* 0.01 mm/s: one tick at 1 mm/s^2 */
	uint8_t brake;    /* 0..200 */
	/* between */
	int16_t target;              /* mm/s, not negative */
	uint16_t acceleration_limit; /* mm/s^2 */
	uint8_t commanded_gear;
	uint8_t commanded_brake;
	uint8_t gear;
	bool command_limited;
	bool braking; /* armed, from a command with a brake on until rest */
	bool holding; /* armed, at rest with the brake on */
	bool resting; /* the brake holds a wheel that may still turn, unseen */
	int32_t ceiling;    /* 0.01 mm/s, of a motor that holds the vehicle */
	int32_t lagging;    /* 0.01 mm/s, measured speed behind a lag */
	uint8_t line_ticks; /* in a row in which a line was outside of its bands; saturates */
	int32_t last_count;
	int32_t pulses; /* since the last tick */
	int32_t travel; /* um since the last tick */
	struct hall hall;
	struct motor motor;
	struct wheel wheel;
};
#else
#error "define BOARD_IS_STEER or BOARD_IS_DRIVE"
#endif

#endif
