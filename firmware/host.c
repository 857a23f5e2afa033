/* The firmware's logic as a shared library: one board, its line and its inputs and outputs. */
#include <stdlib.h>
#include <string.h>

#include "plc.h"

struct host {
	struct plc plc;
	uint32_t sent;
	uint8_t line[4096];
};

static bool keep(void *context, const uint8_t *wire, uint8_t length)
{
	struct host *host = context;
	if (host->sent + length > sizeof host->line)
		return false;
	memcpy(host->line + host->sent, wire, length);
	host->sent += length;
	return true;
}

struct host *host_new(void)
{
	return calloc(1, sizeof(struct host));
}

void host_free(struct host *host)
{
	free(host);
}

void host_reset(struct host *host, uint8_t cause, uint16_t boot_count)
{
	host->plc.transmit = keep;
	host->plc.context = host;
	plc_reset(&host->plc, cause, boot_count);
}

void host_receive(struct host *host, const uint8_t *data, uint32_t length, uint32_t now)
{
	for (uint32_t i = 0; i < length; i++)
		plc_receive(&host->plc, data[i], now);
}

/* Moves what was sent to out; returns its length. */
uint32_t host_take(struct host *host, uint8_t *out)
{
	uint32_t length = host->sent;
	memcpy(out, host->line, length);
	host->sent = 0;
	return length;
}

void host_drop(struct host *host, uint16_t frames)
{
	host->plc.stats.tx_drop += frames;
}

uint8_t host_state(const struct host *host)
{
	return host->plc.state;
}

uint16_t host_faults(const struct host *host)
{
	return host->plc.faults;
}

bool host_alive(const struct host *host)
{
	return host->plc.alive;
}

/* 10 ms; 255: none yet */
uint8_t host_command_age(const struct host *host, uint32_t now)
{
	return plc_command_age(&host->plc, now);
}

uint8_t host_session(const struct host *host)
{
	return host->plc.session;
}

uint8_t host_encode(uint8_t *wire, const uint8_t *header, const uint8_t *payload, uint8_t length)
{
	return frame_encode(wire, header, payload, length);
}

/* Decodes a whole stream; out gets raw frames behind each other, each led by its length. */
uint32_t host_decode(const uint8_t *data, uint32_t length, uint8_t *out, uint32_t counters[5])
{
	struct frame_decoder decoder = { .length = 0 };
	uint32_t used = 0;
	for (uint32_t i = 0; i < length; i++) {
		enum frame_result result = frame_feed(&decoder, data[i]);
		counters[result]++;
		if (result == FRAME_OK) {
			out[used++] = decoder.raw_length;
			memcpy(out + used, decoder.data, decoder.raw_length);
			used += decoder.raw_length;
		}
	}
	return used;
}

#if defined(BOARD_IS_STEER)
void host_tick(struct host *host, uint32_t now, int16_t angle, int16_t rate, uint16_t adc,
	       uint16_t supply, bool estop, int32_t outputs[2])
{
	struct board *board = &host->plc.board;
	board->angle = angle;
	board->rate = rate;
	board->adc = adc;
	board->supply = supply;
	board->estop_input = estop;
	plc_tick(&host->plc, now);
	outputs[0] = board->servo_on;
	outputs[1] = board->setpoint;
}
#else

/* Speeds at ticks 10 ms apart, from the time of the first, and travels between them, from counts
 * and newest edges. */
void host_hall(int32_t pulse, const int32_t *counts, const uint32_t *edges, int32_t ticks,
	       uint32_t start, int16_t *speeds, int32_t *travels)
{
	struct hall hall;
	hall_begin(&hall, pulse, 0);
	for (int32_t i = 0; i < ticks; i++) {
		uint32_t now = start + (uint32_t)i * TICK_US;
		travels[i] = hall_travel(&hall, pulse, counts[i], edges[i], now);
		speeds[i] = hall.speed;
	}
}

struct motor *host_motor_new(void)
{
	return calloc(1, sizeof(struct motor));
}

void host_motor_free(struct motor *motor)
{
	free(motor);
}

int32_t host_motor(struct motor *motor, const struct motor_limits *limits, int32_t setpoint,
		   int16_t speed, int32_t travel)
{
	return motor_torque(motor, limits, setpoint, speed, travel);
}

struct wheel *host_wheel_new(float pulse, float radius, float mass_low, float mass_high)
{
	struct wheel *wheel = calloc(1, sizeof *wheel);
	if (wheel)
		wheel_set_up(wheel, pulse, radius, mass_low, mass_high);
	return wheel;
}

void host_wheel_free(struct wheel *wheel)
{
	free(wheel);
}

void host_wheel_restart(struct wheel *wheel)
{
	wheel_restart(wheel);
}

bool host_wheel_fails(struct wheel *wheel, float torque, int32_t pulses, float speed,
		      float setpoint)
{
	return wheel_fails(wheel, torque, pulses, speed, setpoint);
}

static void tick(struct host *host, uint32_t now, const uint16_t lines[2], uint16_t current,
		 uint16_t supply, bool estop)
{
	struct board *board = &host->plc.board;
	board->hall_adc = lines[0];
	board->direction_adc = lines[1];
	board->current = current;
	board->supply = supply;
	board->estop_input = estop;
	plc_tick(&host->plc, now);
}

/* With a measured speed and the motor's torque of the last tick, mN m; lines: ADC counts of hall and
 * direction. */
void host_tick(struct host *host, uint32_t now, int16_t speed, int32_t hall_count, int32_t torque,
	       const uint16_t lines[2], uint16_t current, uint16_t supply, bool estop,
	       int32_t outputs[3])
{
	struct board *board = &host->plc.board;
	board->speed = speed;
	board->hall_count = hall_count;
	board->torque = torque;
	tick(host, now, lines, current, supply, estop);
	outputs[0] = board->motor_on;
	outputs[1] = board->setpoint;
	outputs[2] = board->brake;
}

/* As the board itself: the speed from hall pulses, the torque (mN m) from its controller. */
void host_tick_pulses(struct host *host, uint32_t now, int32_t hall_count, uint32_t edge_at,
		      const uint16_t lines[2], uint16_t current, uint16_t supply, bool estop,
		      int32_t outputs[4])
{
	struct board *board = &host->plc.board;
	drive_measure(&host->plc, hall_count, edge_at, now);
	tick(host, now, lines, current, supply, estop);
	drive_push(&host->plc);
	outputs[0] = board->torque;
	outputs[1] = board->motor_on;
	outputs[2] = board->setpoint;
	outputs[3] = board->brake;
}

uint16_t host_throttle(const struct host *host)
{
	return drive_throttle(&host->plc.board);
}
#endif
