#include "hardware.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <util/atomic.h>
#include <util/delay.h>

namespace hardware {
namespace {

constexpr uint16_t CYCLES_PER_MS = F_CPU / 1000;
constexpr uint8_t MS_PER_TICK = 1000 / TICK_HZ;
constexpr uint8_t OVERSAMPLES = 4, MOST_UNANSWERED = 4;
constexpr uint16_t RX_SIZE = 128, TX_SIZE = 256;  // powers of two

constexpr uint8_t PIN_AGONIST = PD3, PIN_ANTAGONIST = PB1;     // 3 and 9
constexpr uint8_t PIN_TRIGGER = PD7, PIN_ECHO = PB0;           // 7 and 8
constexpr uint8_t PIN_SENSE[CHANNELS] = {PD5, PD6};            // 5 and 6
constexpr uint8_t PIN_A = PD2, PIN_B = PD4;                    // 2 and 4

volatile uint32_t milliseconds;
volatile uint8_t ticks_due, part_of_tick;

volatile uint16_t sums[INPUTS];
volatile uint8_t at_input, conversions, sensing;
volatile uint16_t total;
volatile bool all_converted;

volatile uint8_t rx[RX_SIZE];
volatile uint8_t rx_head, rx_tail;
volatile uint8_t tx[TX_SIZE];
volatile uint8_t tx_head, tx_tail;

volatile uint32_t echo_began;
volatile uint16_t echo_length;
volatile uint8_t unanswered;  // pings
volatile int16_t counts;
volatile uint8_t phase;

uint8_t cause __attribute__((section(".noinit")));

void stop_watchdog_early() __attribute__((naked, used, section(".init3")));
void stop_watchdog_early() {
    cause = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

uint32_t cycles() {  // interrupts are off; wraps after 268 s
    const uint16_t now = TCNT1;
    uint32_t ms = milliseconds;
    if ((TIFR1 & _BV(TOV1)) && now < CYCLES_PER_MS / 2) ++ms;
    return ms * CYCLES_PER_MS + now;
}

void select(uint8_t i) {
    ADMUX = _BV(REFS0) | i;
    ADCSRA |= _BV(ADSC);
}

}  // namespace

ISR(TIMER1_OVF_vect) {
    milliseconds = milliseconds + 1;
    part_of_tick = part_of_tick + 1;
    if (part_of_tick == MS_PER_TICK) {
        part_of_tick = 0;
        ticks_due = ticks_due + 1;
    }
}

ISR(ADC_vect) {
    total = total + ADC;
    conversions = conversions + 1;
    if (conversions < OVERSAMPLES) {
        ADCSRA |= _BV(ADSC);
        return;
    }
    sums[at_input] = total;
    total = 0;
    conversions = 0;
    const uint8_t sense = sensing;
    if (at_input < 3) {
        at_input = at_input + 1;
    } else if (at_input == 3 && sense != NO_SENSE) {
        at_input = 4 + sense;
    } else {
        PORTD &= ~(_BV(PIN_SENSE[0]) | _BV(PIN_SENSE[1]));
        all_converted = true;
        return;
    }
    select(at_input);
}

ISR(USART_RX_vect) {
    const uint8_t byte = UDR0, next = (rx_head + 1) % RX_SIZE;
    if (next == rx_tail) return;
    rx[rx_head] = byte;
    rx_head = next;
}

ISR(USART_UDRE_vect) {
    if (tx_head == tx_tail) {
        UCSR0B &= ~_BV(UDRIE0);
        return;
    }
    UDR0 = tx[tx_tail];
    tx_tail = tx_tail + 1;
}

ISR(PCINT0_vect) {
    const uint32_t now = cycles();
    if (PINB & _BV(PIN_ECHO)) {
        echo_began = now;
    } else {
        const uint32_t halves = (now - echo_began) / (F_CPU / 2000000);
        echo_length = halves > 0xffff ? 0xffff : halves;
        unanswered = 0;
    }
}

ISR(PCINT2_vect) {
    static const int8_t STEP[16] = {0, -1, 1, 0, 1, 0, 0, -1, -1, 0, 0, 1, 0, 1, -1, 0};
    const uint8_t now = ((PIND >> PIN_A) & 1) << 1 | ((PIND >> PIN_B) & 1);
    counts = counts + STEP[phase << 2 | now];
    phase = now;
}

void begin() {
    PORTD = 0;
    PORTB = 0;
    DDRD = _BV(PIN_AGONIST) | _BV(PIN_TRIGGER) | _BV(PIN_SENSE[0]) | _BV(PIN_SENSE[1]);
    DDRB = _BV(PIN_ANTAGONIST);
    PORTD = _BV(PIN_A) | _BV(PIN_B);  // pull-ups of the encoder

    ICR1 = CYCLES_PER_MS - 1;  // timer 1: fast PWM to ICR1, 1 kHz; its overflow is the clock
    TCCR1A = _BV(WGM11);
    TCCR1B = _BV(WGM13) | _BV(WGM12) | _BV(CS10);
    TIMSK1 = _BV(TOIE1);
    TCCR2A = _BV(WGM21) | _BV(WGM20);  // timer 2: fast PWM, 977 Hz
    TCCR2B = _BV(CS22);

    ADCSRA = _BV(ADEN) | _BV(ADIE) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
    UCSR0A = _BV(U2X0);  // before the divisor: simavr takes the speed when that is written
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UBRR0 = (F_CPU / 4 / 115200 - 1) / 2;
    UCSR0B = _BV(RXCIE0) | _BV(RXEN0) | _BV(TXEN0);

    phase = ((PIND >> PIN_A) & 1) << 1 | ((PIND >> PIN_B) & 1);
    PCMSK0 = _BV(PCINT0);
    PCMSK2 = _BV(PCINT18) | _BV(PCINT20);
    PCICR = _BV(PCIE0) | _BV(PCIE2);
    set_sleep_mode(SLEEP_MODE_IDLE);
    wdt_enable(WDTO_250MS);
    sei();
}

void sleep_until_interrupt() {
    cli();
    if (!ticks_due && !all_converted && rx_head == rx_tail) {
        sleep_enable();
        sei();
        sleep_cpu();
        sleep_disable();
    }
    sei();
}

uint32_t micros() {
    uint32_t ms, now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        now = TCNT1;
        ms = milliseconds;
        if ((TIFR1 & _BV(TOV1)) && now < CYCLES_PER_MS / 2) ++ms;
    }
    return ms * 1000 + now / (F_CPU / 1000000);
}

bool tick() {
    bool due = false;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (ticks_due) {
            ticks_due = ticks_due - 1;
            due = true;
        }
    }
    return due;
}

void start_conversions(uint8_t sense) {
    sensing = sense;
    all_converted = false;
    at_input = 0;
    if (sense != NO_SENSE) PORTD |= _BV(PIN_SENSE[sense]);
    select(0);
}

bool converted() {
    const bool done = all_converted;
    if (done) all_converted = false;
    return done;
}

uint16_t input(uint8_t i) {
    uint16_t value;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { value = sums[i]; }
    return value;
}

void drive(uint8_t channel, uint8_t count) {
    if (channel == 0) {
        if (count == 0) {
            TCCR2A &= ~_BV(COM2B1);
            PORTD &= ~_BV(PIN_AGONIST);
        } else {
            OCR2B = count < 128 ? count - 1 : count;  // (OCR + 1) / 256 is nearest to count / 255
            TCCR2A |= _BV(COM2B1);
        }
    } else {
        if (count == 0) {
            TCCR1A &= ~_BV(COM1A1);
            PORTB &= ~_BV(PIN_ANTAGONIST);
        } else {
            OCR1A = static_cast<uint32_t>(count) * CYCLES_PER_MS / 255 - 1;
            TCCR1A |= _BV(COM1A1);
        }
    }
}

void ping() {
    if (unanswered <= MOST_UNANSWERED) unanswered = unanswered + 1;
    PORTD |= _BV(PIN_TRIGGER);
    _delay_us(10);
    PORTD &= ~_BV(PIN_TRIGGER);
}

uint16_t echo() {
    uint16_t value;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { value = unanswered > MOST_UNANSWERED ? 0 : echo_length; }
    return value;
}

int16_t encoder() {
    int16_t value;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { value = counts; }
    return value;
}

void zero_encoder() {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { counts = 0; }
}

bool receive(uint8_t& byte) {
    if (rx_head == rx_tail) return false;
    byte = rx[rx_tail];
    rx_tail = (rx_tail + 1) % RX_SIZE;
    return true;
}

uint16_t room() { return TX_SIZE - 1 - static_cast<uint8_t>(tx_head - tx_tail); }

void send(uint8_t byte) {
    while (room() == 0) {
    }
    tx[tx_head] = byte;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        tx_head = tx_head + 1;
        UCSR0B |= _BV(UDRIE0);
    }
}

void pat_watchdog() { wdt_reset(); }

void hang() {
    cli();
    for (;;) {
    }
}

uint8_t reset_cause() { return cause; }

}  // namespace hardware
