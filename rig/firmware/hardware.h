// The ATmega328P: tick, PWM, ADC, UART, echo, encoder, watchdog. Nothing else in the firmware touches a register.
#pragma once

#include <stdint.h>

namespace hardware {

constexpr uint16_t TICK_HZ = 200;
constexpr float TICK_S = 1.0f / TICK_HZ;
constexpr uint8_t CHANNELS = 2;
constexpr uint8_t INPUTS = 6;  // A0, A1 thermistors; A2 potentiometer; A3 current; A4, A5 wire resistance
constexpr uint8_t NO_SENSE = 0xff;

void begin();
void sleep_until_interrupt();
uint32_t micros();

bool tick();                      // true once every TICK_S
void start_conversions(uint8_t sense);  // A0..A3, then A4 or A5 under the sensing current where sense is 0 or 1
bool converted();                 // true once, when all are done
uint16_t input(uint8_t i);        // sum of four conversions

void drive(uint8_t channel, uint8_t count);  // 0..255 of the PWM

void ping();           // start an ultrasonic measurement
uint16_t echo();       // last echo in units of 0.5 us; 0: none, or lost
int16_t encoder();     // quadrature counts
void zero_encoder();

bool receive(uint8_t& byte);
uint16_t room();       // bytes that can be sent now
void send(uint8_t byte);

void pat_watchdog();
[[noreturn]] void hang();  // the watchdog's test
uint8_t reset_cause();     // MCUSR after the reset

}  // namespace hardware
