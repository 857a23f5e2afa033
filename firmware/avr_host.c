/* An Arduino UNO simulated by libsimavr, as a shared library: bytes, millivolts and pulses in,
 * bytes and registers out. Time is the AVR's own and moves only in machine_run. */
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_extint.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_cycle_timers.h>
#include <simavr/sim_elf.h>
#include <simavr/sim_io.h>
#include <simavr/sim_irq.h>

#define FREQUENCY 16000000UL
#define BYTE_CYCLES 1389 /* of 115200 8N1 */
#define LINE 16384
/* of the hall sensor's lines behind the resistors at the sensor */
#define LINE_LOW_MV 1000
#define LINE_HIGH_MV 4000
/* data memory addresses of the ATmega328P */
#define PIND 0x29
#define MCUSR 0x54
#define TIMSK2 0x70

struct machine {
	avr_io_t io; /* first: it is told of resets */
	avr_t *avr;
	avr_cycle_count_t end; /* of the last run */
	avr_irq_t *uart_in;
	uint8_t in[LINE], out[LINE];
	uint32_t in_head, in_tail, out_length;
	avr_cycle_count_t hall_period; /* cycles between edges, which are the pulses; 0: the wheel stands */
	avr_cycle_count_t hall_edge; /* of the newest edge */
	uint8_t sensor[2];     /* levels that the hall sensor gives: pulse, direction */
	int32_t line[2];       /* mV of a broken line of it; negative: it is whole */
	uint8_t driven, levels; /* pins of port D */
	uint8_t bootloader;     /* it clears MCUSR at every reset */
};

static void sleep_no_longer(avr_t *avr, avr_cycle_count_t cycles)
{
	(void)avr;
	(void)cycles; /* the caller adds them to the clock */
}

static void on_uart_out(struct avr_irq_t *irq, uint32_t value, void *param)
{
	(void)irq;
	struct machine *machine = param;
	if (machine->out_length < LINE)
		machine->out[machine->out_length++] = (uint8_t)value;
}

/* Drives an input pin of port D; it stays so whatever pull-up the firmware switches. */
void machine_pin(struct machine *machine, uint8_t pin, uint8_t level)
{
	uint8_t bit = (uint8_t)(1 << pin);
	machine->driven |= bit;
	machine->levels = level ? machine->levels | bit : machine->levels & (uint8_t)~bit;
	avr_ioport_external_t external = {
		.name = 'D', .mask = machine->driven, .value = machine->levels,
	};
	avr_ioctl(machine->avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('D'), &external);
	avr_raise_irq(avr_io_getirq(machine->avr, AVR_IOCTL_IOPORT_GETIRQ('D'), pin), level);
}

void machine_adc(struct machine *machine, uint8_t channel, uint32_t millivolts)
{
	avr_raise_irq(avr_io_getirq(machine->avr, AVR_IOCTL_ADC_GETIRQ, channel), millivolts);
}

/* The board sees each of the sensor's two lines at a digital and at an analog pin. */
static void drive_line(struct machine *machine, uint8_t line)
{
	static const uint8_t pins[2] = { 2, 4 };
	int32_t millivolts = machine->line[line];
	if (millivolts < 0)
		millivolts = machine->sensor[line] ? LINE_HIGH_MV : LINE_LOW_MV;
	machine_adc(machine, 2 + line, (uint32_t)millivolts);
	machine_pin(machine, pins[line], millivolts > 2500);
}

/* Level of the hall sensor: line 0 the pulse, 1 the direction. */
void machine_sensor(struct machine *machine, uint8_t line, uint8_t level)
{
	machine->sensor[line] = level;
	drive_line(machine, line);
}

/* Breaks a line of the hall sensor: its voltage from now on in mV; negative: it is whole. */
void machine_break(struct machine *machine, uint8_t line, int32_t millivolts)
{
	machine->line[line] = millivolts;
	drive_line(machine, line);
}

static avr_cycle_count_t feed_uart(avr_t *avr, avr_cycle_count_t when, void *param)
{
	(void)avr;
	struct machine *machine = param;
	if (machine->in_tail != machine->in_head) {
		avr_raise_irq(machine->uart_in, machine->in[machine->in_tail]);
		machine->in_tail = (machine->in_tail + 1) % LINE;
	}
	return when + BYTE_CYCLES;
}

static avr_cycle_count_t hall_edge(avr_t *avr, avr_cycle_count_t when, void *param)
{
	(void)avr;
	struct machine *machine = param;
	machine->hall_edge = when;
	machine_sensor(machine, 0, !machine->sensor[0]);
	return when + machine->hall_period;
}

/* After the first instruction: pins are at their levels, which the simulation's reset has cleared
 * in the register but not behind it. */
static avr_cycle_count_t after_reset(avr_t *avr, avr_cycle_count_t when, void *param)
{
	(void)when;
	struct machine *machine = param;
	avr->data[PIND] = machine->levels & machine->driven;
	if (machine->bootloader)
		avr->data[MCUSR] = 0;
	return 0;
}

/* A reset, the watchdog's too, stops all timers of the simulation. */
static void on_reset(struct avr_io_t *io)
{
	struct machine *machine = (struct machine *)io;
	avr_t *avr = machine->avr;
	avr_cycle_timer_register(avr, BYTE_CYCLES, feed_uart, machine);
	if (machine->hall_period) {
		avr_cycle_count_t passed = avr->cycle - machine->hall_edge;
		avr_cycle_timer_register(
			avr, passed < machine->hall_period ? machine->hall_period - passed : 1,
			hall_edge, machine);
	}
	avr_cycle_timer_register(avr, 1, after_reset, machine);
}

static void no_log(avr_t *avr, const int level, const char *format, va_list values)
{
	(void)avr;
	(void)level;
	(void)format;
	(void)values;
}

struct machine *machine_new(const char *elf)
{
	avr_global_logger_set(no_log); /* it prints a line for every image that it loads */
	elf_firmware_t firmware = { .frequency = FREQUENCY };
	if (elf_read_firmware(elf, &firmware) != 0)
		return NULL;
	struct machine *machine = calloc(1, sizeof *machine);
	avr_t *avr = avr_make_mcu_by_name("atmega328p");
	avr_init(avr);
	firmware.frequency = FREQUENCY;
	avr_load_firmware(avr, &firmware);
	avr->log = LOG_NONE;
	avr->sleep = sleep_no_longer;
	avr->run_cycle_limit = FREQUENCY / 1000;
	avr->vcc = avr->avcc = avr->aref = 5000;
	for (uint8_t i = 0; i < 2; i++)
		avr_extint_set_strict_lvl_trig(avr, i, 0);
	uint32_t flags = 0;
	avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
	flags &= ~(uint32_t)(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
	avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
	machine->avr = avr;
	machine->uart_in = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
	avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT),
				on_uart_out, machine);
	avr_cycle_timer_register(avr, BYTE_CYCLES, feed_uart, machine);
	machine->line[0] = machine->line[1] = -1;
	machine->io.kind = "machine";
	machine->io.reset = on_reset;
	avr_register_io(avr, &machine->io);
	return machine;
}

void machine_free(struct machine *machine)
{
	avr_terminate(machine->avr);
	free(machine);
}

/* Runs to so many microseconds after its start; 0 where the AVR crashed. */
int machine_run(struct machine *machine, uint64_t until)
{
	machine->end = until * (FREQUENCY / 1000000);
	while (machine->avr->cycle < machine->end) {
		int state = avr_run(machine->avr);
		if (state == cpu_Done || state == cpu_Crashed)
			return 0;
	}
	return 1;
}

void machine_write(struct machine *machine, const uint8_t *data, uint32_t length)
{
	for (uint32_t i = 0; i < length; i++) {
		machine->in[machine->in_head] = data[i];
		machine->in_head = (machine->in_head + 1) % LINE;
	}
}

uint32_t machine_read(struct machine *machine, uint8_t *out)
{
	uint32_t length = machine->out_length;
	memcpy(out, machine->out, length);
	machine->out_length = 0;
	return length;
}

/* Pulses per second of the hall sensor. A changed rate keeps the phase: the part of the period that
 * has passed stays passed. */
void machine_hall(struct machine *machine, double rate)
{
	avr_t *avr = machine->avr;
	avr_cycle_count_t period = rate > 0.1 ? (avr_cycle_count_t)(FREQUENCY / rate) : 0;
	if (period == machine->hall_period)
		return;
	double phase = machine->hall_period ?
		(double)(avr->cycle - machine->hall_edge) / (double)machine->hall_period : 0;
	avr_cycle_timer_cancel(avr, hall_edge, machine);
	machine->hall_period = period;
	if (period) {
		phase = phase < 1 ? phase : 1;
		avr_cycle_count_t passed = (avr_cycle_count_t)(phase * (double)period);
		machine->hall_edge = avr->cycle - passed;
		avr_cycle_timer_register(avr, period - passed + 1, hall_edge, machine);
	}
}

void machine_reset(struct machine *machine)
{
	avr_reset(machine->avr);
}

/* From now on, every reset goes through a bootloader that clears MCUSR. */
void machine_bootloader(struct machine *machine)
{
	machine->bootloader = 1;
}

/* The program ticks no more, as if it hung; its watchdog resets it. */
void machine_hang(struct machine *machine)
{
	machine->avr->data[TIMSK2] = 0;
}

/* A data memory address; two bytes, little endian. */
uint16_t machine_word(const struct machine *machine, uint16_t address)
{
	return (uint16_t)(machine->avr->data[address] | machine->avr->data[address + 1] << 8);
}
