/* The Arduino UNO around the boards' logic: UART rings, clock, pins, EEPROM, watchdog.
 *
 * Pins of both boards: 0, 1 UART; 3 e-stop (normally closed to ground: open or broken = pressed);
 * 8 alive; A1 supply through a divider by 11. Steer: 9 servo pulse (100 Hz), A0 potentiometer.
 * Drive: 9 motor PWM (20 kHz), 7 motor direction, 10 brake PWM, 2 and A2 hall pulses, 4 and A3 hall
 * direction, A0 motor current, 100 mV/A. Timer 2 is the clock, timer 1 the outputs.
 *
 * In reset and in the bootloader all of them float: 7, 8 and 9 need a resistor to ground each, 10 one
 * to 5 V (docs/how-to-wiring.md). Pin 3 has a pull-up from the start of this program; the hall sensor's
 * lines have theirs outside, which are weak enough not to hide an unsupplied sensor. */
#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <util/atomic.h>

#include "plc.h"

#define RX_SIZE 128 /* powers of two; 11 ms of line */
#define TX_SIZE 256
#define BOOT_COUNT ((uint16_t *)0)
#define SUPPLY_MV(adc) ((uint16_t)((uint32_t)(adc) * (5000UL * SUPPLY_DIVIDER) / 1023))

static struct plc plc;

/* ---- reset cause: read before anything else, then the watchdog off until the loop runs ---- */

#define KEY 0x7E57B0A4UL

static uint8_t reset_flags __attribute__((section(".noinit")));
/* lasts through a reset, and through a bootloader that clears MCUSR; random after power-on */
static struct {
	uint32_t key;
	bool hung;
} kept __attribute__((section(".noinit")));

void save_reset_flags(void) __attribute__((naked, used, section(".init3")));
void save_reset_flags(void)
{
	reset_flags = MCUSR;
	MCUSR = 0;
	wdt_disable();
}

/* The first time-out; the second one resets, also where interrupts are off and this never runs. */
ISR(WDT_vect)
{
	kept.hung = true;
	TCCR1A = 0;
	DDRB = PORTB = 0; /* the outputs float as in reset: their resistors brake, without torque */
	for (;;)
		;
}

static uint8_t reset_cause(void)
{
	bool intact = kept.key == KEY;
	bool hung = intact && kept.hung;
	kept.key = KEY;
	kept.hung = false;
	if (reset_flags == 0) /* a bootloader has cleared them */
		return hung ? RESET_CAUSE_WATCHDOG :
		       intact ? RESET_CAUSE_EXTERNAL :
				RESET_CAUSE_POWER_ON;
	/* the flags are the protocol's values; where several are set, the rarest counts */
	static const uint8_t order[] = { RESET_CAUSE_WATCHDOG, RESET_CAUSE_BROWN_OUT,
					 RESET_CAUSE_EXTERNAL };
	for (uint8_t i = 0; i < sizeof order; i++)
		if (reset_flags & order[i])
			return order[i];
	return RESET_CAUSE_POWER_ON;
}

/* ---- clock: timer 2 interrupts at 1 kHz, its counter steps in 4 us ---- */

static volatile uint32_t milliseconds;
static volatile bool tick_due;
static volatile bool tick_late;

ISR(TIMER2_COMPA_vect)
{
	static uint8_t countdown = TICK_US / 1000;
	milliseconds++;
	if (--countdown == 0) {
		countdown = TICK_US / 1000;
		tick_late |= tick_due;
		tick_due = true;
	}
}

static uint32_t micros(void)
{
	uint32_t ms;
	uint8_t quarter;
	bool pending;
	ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
	{
		ms = milliseconds;
		quarter = TCNT2;
		pending = TIFR2 & _BV(OCF2A);
	}
	if (pending && quarter < 125)
		ms++;
	return ms * 1000 + quarter * 4U;
}

/* ---- UART ---- */

static volatile uint8_t rx_ring[RX_SIZE];
static volatile uint8_t rx_head, rx_tail;
static volatile uint16_t rx_lost;
static volatile uint8_t tx_ring[TX_SIZE];
static volatile uint8_t tx_head, tx_tail; /* wrap by themselves at 256 */

ISR(USART_RX_vect)
{
	do {
		bool overrun = UCSR0A & _BV(DOR0);
		uint8_t byte = UDR0;
		uint8_t next = (rx_head + 1) & (RX_SIZE - 1);
		if (overrun || next == rx_tail)
			rx_lost++;
		if (next != rx_tail) {
			rx_ring[rx_head] = byte;
			rx_head = next;
		}
	} while (UCSR0A & _BV(RXC0));
}

ISR(USART_UDRE_vect)
{
	if (tx_head == tx_tail)
		UCSR0B &= (uint8_t)~_BV(UDRIE0);
	else
		UDR0 = tx_ring[tx_tail++];
}

static bool transmit(void *context, const uint8_t *wire, uint8_t length)
{
	(void)context;
	uint8_t used = (uint8_t)(tx_head - tx_tail);
	if (length > TX_SIZE - 1 - used)
		return false;
	for (uint8_t i = 0; i < length; i++) {
		tx_ring[tx_head] = wire[i]; /* first: the interrupt sends what is before the head */
		tx_head++;
	}
	UCSR0B |= _BV(UDRIE0);
	return true;
}

static void receive(void)
{
	while (rx_tail != rx_head) {
		uint8_t byte = rx_ring[rx_tail];
		rx_tail = (rx_tail + 1) & (RX_SIZE - 1);
		plc_receive(&plc, byte, micros());
	}
}

/* ---- inputs ---- */

static uint16_t adc(uint8_t channel)
{
	ADMUX = _BV(REFS0) | channel;
	ADCSRA |= _BV(ADSC);
	while (ADCSRA & _BV(ADSC))
		;
	return ADC;
}

#if defined(BOARD_IS_STEER)

static void setup_outputs(void)
{
	DDRB = _BV(PB0) | _BV(PB1);
	PORTD |= _BV(PD2) | _BV(PD4); /* pull-ups: nothing is connected */
	TCCR1B = _BV(CS10); /* 16 MHz: a step of the pulse is 62.5 ns, a tenth of a mrad */
}

static void read_inputs(void)
{
	struct board *board = &plc.board;
	int16_t last = board->angle;
	board->adc = adc(0);
	board->angle = (int16_t)(((int32_t)board->adc - ADC_CENTRE) * 10000 / ADC_SCALE);
	/* 1e-4 rad per 10 ms are 1e-2 rad/s; a count is 0.23 rad/s, so smooth it */
	int32_t rate = board->rate + ((board->angle - last) * 10L - board->rate) / 4;
	board->rate = (int16_t)clamp(rate, INT16_MIN, INT16_MAX); /* of a broken wire */
}

/* One pulse per tick, begun here and ended by the timer: a loop that hangs makes none. */
static void write_outputs(void)
{
	const struct board *board = &plc.board;
	if (!board->servo_on) {
		TCCR1A = 0; /* the pin is low */
		return;
	}
	ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
	{
		OCR1A = steer_pulse(board->setpoint);
		TCCR1A = _BV(COM1A1) | _BV(COM1A0); /* set at a compare match ... */
		TCNT1 = 0;
		TCCR1C = _BV(FOC1A);   /* ... which is now, ... */
		TCCR1A = _BV(COM1A1); /* ... and cleared at the next */
	}
}

#else

static volatile int32_t pulses;
static volatile uint32_t pulse_at; /* us */

ISR(INT0_vect)
{
	pulses += PIND & _BV(PD4) ? 1 : -1;
	pulse_at = micros();
}

static void setup_outputs(void)
{
	ICR1 = PWM_TOP; /* 20 kHz */
	DDRB = _BV(PB0) | _BV(PB1) | _BV(PB2);
	DDRD |= _BV(PD7);
	OCR1B = ICR1;
	TCCR1A = _BV(COM1A1) | _BV(COM1B1) | _BV(WGM11);
	TCCR1B = _BV(WGM13) | _BV(WGM12) | _BV(CS10);
	EICRA = _BV(ISC00); /* both edges: three halls behind an XOR gate give six per pole pair */
	EIMSK = _BV(INT0);
}

static void read_inputs(void)
{
	int32_t count;
	uint32_t edge_at;
	ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
	{
		count = pulses;
		edge_at = pulse_at;
	}
	drive_measure(&plc, count, edge_at, micros()); /* not before the edge */
	plc.board.hall_adc = adc(2);
	plc.board.direction_adc = adc(3);
	plc.board.current = (uint16_t)(adc(0) * 50000UL / 1023);
}

static void write_outputs(void)
{
	const struct board *board = &plc.board;
	drive_push(&plc);
	uint16_t level = drive_throttle(board);
	PORTD = board->torque < 0 ? PORTD | _BV(PD7) : PORTD & (uint8_t)~_BV(PD7);
	/* in this mode a compare value of 0 still gives a spike: cut the pin off instead */
	OCR1A = level;
	TCCR1A = level ? TCCR1A | _BV(COM1A1) : TCCR1A & (uint8_t)~_BV(COM1A1);
	OCR1B = (uint16_t)((uint32_t)board->brake * PWM_TOP / MAX_BRAKE);
	TCCR1A = board->brake ? TCCR1A | _BV(COM1B1) : TCCR1A & (uint8_t)~_BV(COM1B1);
}

#endif

static void tick(void)
{
	uint32_t start = micros();
	wdt_reset(); /* here only, so that a loop that no longer ticks is reset */
	ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
	{
		plc.stats.rx_overrun = rx_lost;
		plc.stats.tick_overrun += tick_late;
		tick_late = false;
	}
	plc.board.estop_input = PIND & _BV(PD3);
	plc.board.supply = SUPPLY_MV(adc(1));
	read_inputs();
	plc_tick(&plc, start);
	write_outputs();
	PORTB = plc.alive ? PORTB | _BV(PB0) : PORTB & (uint8_t)~_BV(PB0);
	uint32_t took = micros() - start;
	if (took > plc.stats.max_tick)
		plc.stats.max_tick = took < 0xFFFF ? (uint16_t)took : 0xFFFF;
}

int main(void)
{
	PORTD |= _BV(PD3); /* pull-up */
	setup_outputs();
	ADCSRA = _BV(ADEN) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
	OCR2A = 249;
	TCCR2A = _BV(WGM21);
	TIMSK2 = _BV(OCIE2A);
	TCCR2B = _BV(CS22); /* 16 MHz / 64 */
	UCSR0A = _BV(U2X0); /* first: simavr looks at it when UBRR0 is written */
	UBRR0 = 16;         /* 115200 at double speed, 2.1 % fast */
	UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);

	uint16_t boot_count = (uint16_t)(eeprom_read_word(BOOT_COUNT) + 1);
	if (boot_count == 0) /* the memory was erased */
		boot_count = 1;
	eeprom_update_word(BOOT_COUNT, boot_count);
	plc.transmit = transmit;
	plc_reset(&plc, reset_cause(), boot_count);
	plc.build_hash = BUILD_HASH;
	_Static_assert(HARDWARE_WATCHDOG_MS == 60, "twice the argument of wdt_enable");
	wdt_enable(WDTO_30MS);
	WDTCSR |= _BV(WDIE); /* an interrupt first */
	set_sleep_mode(SLEEP_MODE_IDLE);
	sei();
	for (;;) {
		receive();
		cli();
		bool due = tick_due;
		tick_due = false;
		if (!due && rx_tail == rx_head) {
			sleep_enable();
			sei(); /* the instruction after it still runs before any interrupt */
			sleep_cpu();
			sleep_disable();
		}
		sei();
		if (due)
			tick();
	}
}
