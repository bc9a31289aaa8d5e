/* An Arduino Uno in simavr for Python: run cycles, read the PWM's duty, set volts at the ADC, move UART bytes.
   Time passes only in board_run, so a run is the same each time. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_extint.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <simavr/sim_irq.h>

enum { INPUTS = 6, QUEUE = 1 << 16, CLOCK = 16000000, BYTE_CYCLES = CLOCK / 11520, MOST_CYCLES = 16000 };
enum { DDRB = 0x24, PORTB = 0x25, DDRD = 0x2a, PORTD = 0x2b, TCCR1A = 0x80, ICR1L = 0x86, OCR1AL = 0x88,
       TCCR2A = 0xb0, OCR2B = 0xb4 };

typedef struct {
    uint8_t bytes[QUEUE];
    uint32_t head, tail;
} queue_t;

typedef struct {
    avr_t *avr;
    avr_irq_t *uart_in, *adc[INPUTS], *echo, *encoder_a, *encoder_b;
    queue_t in, out;
    double millivolts[INPUTS], noise;
    uint64_t random, lost, resets;
    uint64_t echo_cycles;
    int32_t encoder, encoder_wanted;
    int triggered, fresh, paused;
    void (*core_reset)(avr_t *);
} board_t;

static board_t *of(avr_t *avr) { return avr->custom.data; }

static int push(queue_t *q, uint8_t byte) {
    if (q->head - q->tail == QUEUE) return 0;
    q->bytes[q->head++ % QUEUE] = byte;
    return 1;
}

static double uniform(board_t *b) { /* xorshift64* */
    b->random ^= b->random >> 12;
    b->random ^= b->random << 25;
    b->random ^= b->random >> 27;
    return ((b->random * 2685821657736338717ull) >> 11) * (1.0 / 9007199254740992.0);
}

static double normal(board_t *b) { return sqrt(-2.0 * log(1.0 - uniform(b))) * cos(2.0 * M_PI * uniform(b)); }

static void on_sent(avr_irq_t *irq, uint32_t value, void *param) {
    board_t *b = param;
    (void)irq;
    if (!push(&b->out, value)) b->lost++;
}

static void on_conversion(avr_irq_t *irq, uint32_t value, void *param) {
    board_t *b = param;
    (void)irq, (void)value;
    for (int i = 0; i < INPUTS; i++) {
        double mv = b->millivolts[i] + (b->noise > 0 ? b->noise * normal(b) : 0.0);
        avr_raise_irq(b->adc[i], mv <= 0 ? 0 : mv >= 5000 ? 5000 : (uint32_t)(mv + 0.5));
    }
}

static avr_cycle_count_t next_byte(avr_t *avr, avr_cycle_count_t when, void *param) {
    board_t *b = param;
    (void)avr;
    if (b->in.head == b->in.tail) return b->paused = 1, 0;
    avr_raise_irq(b->uart_in, b->in.bytes[b->in.tail++ % QUEUE]);
    return when + BYTE_CYCLES;
}

static avr_cycle_count_t echo_ends(avr_t *avr, avr_cycle_count_t when, void *param) {
    (void)avr, (void)when;
    avr_raise_irq(((board_t *)param)->echo, 0);
    return 0;
}

static avr_cycle_count_t echo_begins(avr_t *avr, avr_cycle_count_t when, void *param) {
    board_t *b = param;
    (void)when;
    if (!b->echo_cycles) return 0;
    avr_raise_irq(b->echo, 1);
    avr_cycle_timer_register(avr, b->echo_cycles, echo_ends, b);
    return 0;
}

static void on_trigger(avr_irq_t *irq, uint32_t value, void *param) {
    board_t *b = param;
    (void)irq;
    if (b->triggered && !value) avr_cycle_timer_register_usec(b->avr, 450, echo_begins, b);
    b->triggered = value;
}

static avr_cycle_count_t turn(avr_t *avr, avr_cycle_count_t when, void *param) {
    static const uint8_t A[4] = {1, 0, 0, 1}, B[4] = {1, 1, 0, 0}; /* at 0 both are pulled up */
    board_t *b = param;
    if (b->encoder != b->encoder_wanted) {
        b->encoder += b->encoder < b->encoder_wanted ? 1 : -1;
        const uint8_t a = A[b->encoder & 3], c = B[b->encoder & 3];
        avr_ioport_external_t pins = {.name = 'D', .mask = 0x14, .value = a << 2 | c << 4};
        avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('D'), &pins); /* or every write to PORTD pulls them up again */
        avr_raise_irq(b->encoder_a, a);
        avr_raise_irq(b->encoder_b, c);
    }
    return when + CLOCK / 20000;
}

static void on_reset(avr_t *avr) {
    board_t *b = of(avr);
    b->core_reset(avr);
    b->fresh = 1;
    b->resets++;
}

static void no_sleep(avr_t *avr, avr_cycle_count_t cycles) { (void)avr, (void)cycles; }
static void no_log(avr_t *avr, const int level, const char *format, va_list ap) { (void)avr, (void)level, (void)format, (void)ap; }

/* A reset, the watchdog's too, brings these back to simavr's own. */
static void set_up(board_t *b) {
    avr_t *avr = b->avr;
    uint32_t flags = 0;
    avr->sleep = no_sleep;
    avr->run_cycle_limit = MOST_CYCLES;
    avr_extint_set_strict_lvl_trig(avr, 0, 0);
    avr_extint_set_strict_lvl_trig(avr, 1, 0);
    avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
    flags &= ~(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POOL_SLEEP);
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_cycle_timer_cancel(avr, next_byte, b);
    avr_cycle_timer_register(avr, BYTE_CYCLES, next_byte, b);
    avr_cycle_timer_cancel(avr, turn, b);
    avr_cycle_timer_register(avr, CLOCK / 20000, turn, b);
    b->paused = 0;
    b->fresh = 0;
}

board_t *board_open(const char *elf, uint64_t seed) {
    elf_firmware_t firmware;
    board_t *b = calloc(1, sizeof *b);
    avr_global_logger_set(no_log);
    memset(&firmware, 0, sizeof firmware);
    if (!b || elf_read_firmware(elf, &firmware) || !(b->avr = avr_make_mcu_by_name("atmega328p"))) return free(b), NULL;
    avr_init(b->avr);
    firmware.frequency = CLOCK;
    firmware.vcc = firmware.avcc = firmware.aref = 5000;
    avr_load_firmware(b->avr, &firmware);
    b->avr->custom.data = b;
    b->core_reset = b->avr->reset;
    b->avr->reset = on_reset;
    b->random = seed * 2654435761u + 88172645463325252ull;
    b->uart_in = avr_io_getirq(b->avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    b->echo = avr_io_getirq(b->avr, AVR_IOCTL_IOPORT_GETIRQ('B'), 0);
    b->encoder_a = avr_io_getirq(b->avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 2);
    b->encoder_b = avr_io_getirq(b->avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 4);
    for (int i = 0; i < INPUTS; i++) b->adc[i] = avr_io_getirq(b->avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0 + i);
    avr_irq_register_notify(avr_io_getirq(b->avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_sent, b);
    avr_irq_register_notify(avr_io_getirq(b->avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_OUT_TRIGGER), on_conversion, b);
    avr_irq_register_notify(avr_io_getirq(b->avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 7), on_trigger, b);
    set_up(b);
    return b;
}

void board_close(board_t *b) {
    avr_terminate(b->avr);
    free(b);
}

void board_reset(board_t *b) { avr_reset(b->avr); }

static void duties(const board_t *b, double duty[2]) {
    const uint8_t *d = b->avr->data;
    const double agonist = d[TCCR2A] & 0x20 ? (d[OCR2B] + 1) / 256.0 : d[PORTD] >> 3 & 1;
    const uint16_t top = d[ICR1L] | d[ICR1L + 1] << 8, at = d[OCR1AL] | d[OCR1AL + 1] << 8;
    const double antagonist = d[TCCR1A] & 0x80 ? (at + 1.0) / (top + 1.0) : d[PORTB] >> 1 & 1;
    duty[0] = d[DDRD] & 0x08 ? agonist : 0.0;
    duty[1] = d[DDRB] & 0x02 ? antagonist : 0.0;
}

/* Runs to this cycle of simulated time or a little beyond; mean duty of both channels. 0, or simavr's state where it stopped. */
int board_run(board_t *b, uint64_t until, double mean[2]) {
    avr_t *avr = b->avr;
    const uint64_t began = avr->cycle;
    double now[2];
    mean[0] = mean[1] = 0.0;
    if (b->paused && b->in.head != b->in.tail) {
        b->paused = 0;
        avr_cycle_timer_register(avr, BYTE_CYCLES, next_byte, b);
    }
    while (avr->cycle < until) {
        const uint64_t before = avr->cycle;
        duties(b, now);
        const int state = avr_run(avr);
        if (b->fresh) set_up(b);
        const uint64_t passed = avr->cycle > before ? avr->cycle - before : 0;
        mean[0] += now[0] * passed;
        mean[1] += now[1] * passed;
        if (state == cpu_Done || state == cpu_Crashed) return state;
    }
    if (avr->cycle > began) {
        mean[0] /= avr->cycle - began;
        mean[1] /= avr->cycle - began;
    }
    return 0;
}

uint64_t board_cycle(const board_t *b) { return b->avr->cycle; }
uint64_t board_resets(const board_t *b) { return b->resets; }
uint64_t board_lost(const board_t *b) { return b->lost; }
void board_duty(const board_t *b, double duty[2]) { duties(b, duty); }
void board_noise(board_t *b, double millivolts) { b->noise = millivolts; }
void board_echo(board_t *b, double seconds) { b->echo_cycles = seconds > 0 ? (uint64_t)(seconds * CLOCK) : 0; }
void board_encoder(board_t *b, int32_t counts) { b->encoder_wanted = counts; }

void board_inputs(board_t *b, const double volts[INPUTS]) {
    for (int i = 0; i < INPUTS; i++) b->millivolts[i] = 1000.0 * volts[i];
}

uint32_t board_write(board_t *b, const uint8_t *bytes, uint32_t n) {
    uint32_t i = 0;
    while (i < n && push(&b->in, bytes[i])) i++;
    return i;
}

uint32_t board_read(board_t *b, uint8_t *bytes, uint32_t most) {
    uint32_t n = 0;
    while (n < most && b->out.tail != b->out.head) bytes[n++] = b->out.bytes[b->out.tail++ % QUEUE];
    return n;
}
