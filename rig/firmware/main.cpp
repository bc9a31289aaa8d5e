// scpjax rig: drives two heated actuators, reads their sensors, and lets nothing burn. See rig/README.md.
#include <avr/pgmspace.h>
#include <string.h>

#include "config.h"
#include "control.h"
#include "hardware.h"
#include "protocol.h"
#include "safety.h"

namespace {

using protocol::Command;
using protocol::Status;
using safety::Fault;

constexpr uint8_t ECHO_TICKS = 12;         // 60 ms, so that no echo meets the next ping
constexpr uint8_t CALIBRATION_TICKS = 64;
constexpr uint8_t FRAME = 49, SPARE = 36;  // bytes; the stream leaves room for a reply
constexpr uint8_t POTENTIOMETER = 0, ECHO = 1;

Fault fault = Fault::NONE;
uint16_t host_age;                         // ticks since the last good frame
uint8_t stream_every, stream_wait;         // ticks
uint8_t sense_asked = hardware::NO_SENSE, sensing = hardware::NO_SENSE;
uint8_t calibration_left, echo_wait;
uint32_t calibration[4], stamp;
bool converting;

const char NAME[] PROGMEM = "scpjax-rig";
const char RELEASE[] PROGMEM = "1.0.1";
const char PINS[] PROGMEM = "3:9:A0:A1:A2:A3:A4:A5:7:8:5:6:2:4";

uint16_t position() {
    const uint8_t source = static_cast<uint8_t>(safety::get(P_position_source));
    if (source == POTENTIOMETER) return hardware::input(2);
    return source == ECHO ? hardware::echo() : static_cast<uint16_t>(hardware::encoder());
}

float counts_of_position() {
    const uint16_t raw = position();
    return safety::get(P_position_source) >= 2.0f ? static_cast<float>(static_cast<int16_t>(raw)) : raw;
}

void apply() {
    for (uint8_t c = 0; c < hardware::CHANNELS; ++c) hardware::drive(c, control::driven()[c]);
}

void off() {
    control::stop();
    apply();
}

void banner() {
    if (!protocol::begin('B', hardware::micros(), 140)) return;
    protocol::text(NAME);
    protocol::integer(protocol::VERSION);
    protocol::text(RELEASE);
    protocol::field(hardware::reset_cause(), 2);
    protocol::integer(hardware::TICK_HZ);
    protocol::text(PINS);
    static const uint8_t LIMITS[] = {P_max_temperature, P_max_energy, P_sustained_power, P_max_on, P_max_current};
    for (uint8_t p : LIMITS) protocol::integer(static_cast<uint32_t>(safety::get(p)));
    protocol::end();
}

void reply(uint16_t to, Status status, uint32_t value) {
    if (!protocol::begin('A', hardware::micros(), 48)) return;
    protocol::field(to, 4);
    protocol::field(status, 1);
    protocol::field(value, 8);
    protocol::end();
}

void event(Fault what, uint8_t channel) {
    if (!protocol::begin('E', hardware::micros(), 40)) return;
    protocol::field(what, 2);
    protocol::field(channel, 1);
    protocol::end();
}

uint32_t bits(float value) {
    uint32_t out;
    memcpy(&out, &value, sizeof out);
    return out;
}

Status parameter(const Command& command, bool write, uint32_t& value) {
    if (command.fields[0] >= PARAMETER_COUNT) return protocol::OUT_OF_RANGE;
    const uint8_t index = command.fields[0];
    if (write) {
        float wanted;
        memcpy(&wanted, &command.fields[1], sizeof wanted);
        if (!safety::set(index, wanted)) return protocol::OUT_OF_RANGE;
    }
    value = bits(safety::get(index));
    return protocol::OK;
}

Status table(const Command& command, uint32_t& value) {
    Status status = protocol::OK;
    const uint16_t count = command.count - 1;
    if (count > control::free_slots()) {
        status = protocol::FULL;
    } else {
        for (uint16_t i = 0; i < count; ++i) {
            if (!control::append(command.fields[0] + i, command.fields[i + 1])) status = protocol::OUT_OF_RANGE;
        }
    }
    value = static_cast<uint32_t>(control::received()) << 16 | control::free_slots();
    return status;
}

Status start(const Command& command, control::Mode mode) {
    if (fault) return protocol::FAULTY;
    if (control::mode() != control::IDLE) return protocol::BUSY;
    if (command.fields[0] > 255 || command.fields[1] > 0xffff) return protocol::OUT_OF_RANGE;
    if (!control::start(mode, command.fields[0], command.fields[1])) return protocol::BAD_ARGUMENTS;
    stream_wait = 0;  // in step with the table, so that a sample shows what the controller saw
    return protocol::OK;
}

Status hold(const Command& command) {
    if (fault) return protocol::FAULTY;
    if (control::mode() != control::IDLE && control::mode() != control::HOLD) return protocol::BUSY;
    if (command.fields[0] > 255 || command.fields[1] > 255) return protocol::OUT_OF_RANGE;
    control::hold(command.fields[0], command.fields[1]);
    return protocol::OK;
}

Status calibrate() {
    if (control::mode() != control::IDLE) return protocol::BUSY;
    for (uint32_t& total : calibration) total = 0;
    calibration_left = CALIBRATION_TICKS;
    return protocol::OK;
}

Status clear() {
    if (fault && !safety::may_clear()) return protocol::FAULTY;
    fault = Fault::NONE;
    return protocol::OK;
}

Status obey(const Command& command, uint32_t& value) {
    struct Shape {
        char kind;
        uint8_t least, most;
    };
    static const Shape SHAPES[] = {{'?', 0, 0}, {'H', 0, 0}, {'W', 2, 2}, {'R', 1, 1}, {'T', 2, 13}, {'P', 2, 2},
                                   {'C', 2, 2}, {'V', 2, 2}, {'U', 1, 1}, {'K', 0, 0}, {'Z', 1, 1},  {'S', 0, 0},
                                   {'F', 0, 0}, {'X', 1, 1}};
    const Shape* shape = nullptr;
    for (const Shape& s : SHAPES) {
        if (s.kind == command.kind) shape = &s;
    }
    if (!shape) return protocol::UNKNOWN;
    if (command.count < shape->least || command.count > shape->most) return protocol::BAD_ARGUMENTS;
    switch (command.kind) {
        case '?': banner(); break;
        case 'H': value = static_cast<uint32_t>(protocol::bad_frames()) << 16 | fault << 8 | control::mode(); break;
        case 'W': return hold(command);
        case 'R':
            if (command.fields[0] > 255) return protocol::OUT_OF_RANGE;
            stream_every = command.fields[0];
            stream_wait = 0;
            break;
        case 'T': return table(command, value);
        case 'P': return start(command, control::PLAY);
        case 'C': return start(command, control::LOOP);
        case 'V': return parameter(command, true, value);
        case 'U': return parameter(command, false, value);
        case 'K': return calibrate();
        case 'Z':
            if (command.fields[0] >= hardware::CHANNELS) return protocol::OUT_OF_RANGE;
            sense_asked = command.fields[0];
            break;
        case 'S': off(); break;
        case 'F': return clear();
        case 'X':
            if (command.fields[0] != 0xdead) return protocol::BAD_ARGUMENTS;
            if (!safety::may_hang()) return protocol::FAULTY;
            hardware::hang();
    }
    return protocol::OK;
}

void calibrate_tick() {
    if (!calibration_left) return;
    const uint16_t seen[4] = {hardware::input(0), hardware::input(1), position(), hardware::input(3)};
    for (uint8_t i = 0; i < 4; ++i) calibration[i] += seen[i];
    if (--calibration_left) return;
    safety::look_for_sensors();
    if (!protocol::begin('K', stamp, 60)) return;
    for (uint32_t total : calibration) protocol::field(total, 6);
    protocol::end();
}

void stream() {
    if (!stream_every) return;
    if (stream_wait) {
        --stream_wait;
        return;
    }
    stream_wait = stream_every - 1;
    if (!protocol::begin('D', stamp, FRAME + SPARE)) return;
    const uint32_t driven = static_cast<uint32_t>(control::driven()[0]) << 8 | control::driven()[1];
    protocol::field(driven << 8 | control::mode() | fault << 2 | safety::fitted() << 6, 6);
    protocol::field(static_cast<uint32_t>(hardware::input(0)) << 12 | hardware::input(1), 6);
    protocol::field(position(), 4);
    protocol::field(hardware::input(3), 3);
    protocol::end();
}

void resistance() {
    if (sensing == hardware::NO_SENSE) return;
    if (protocol::begin('Z', stamp, 40)) {
        protocol::field(sensing, 1);
        protocol::field(hardware::input(4 + sensing), 3);
        protocol::end();
    }
    sensing = hardware::NO_SENSE;
}

void begin_tick() {
    stamp = hardware::micros();
    sensing = sense_asked;
    sense_asked = hardware::NO_SENSE;
    if (sensing != hardware::NO_SENSE) {
        for (uint8_t c = 0; c < hardware::CHANNELS; ++c) hardware::drive(c, 0);
    }
    hardware::start_conversions(sensing);
    if (safety::get(P_position_source) == ECHO && echo_wait-- == 0) {
        echo_wait = ECHO_TICKS - 1;
        hardware::ping();
    }
}

// What is to be applied is charged to the actuators first: nothing that comes later can take it back.
void end_tick() {
    if (control::mode() == control::LOOP && safety::get(P_position_source) == ECHO && position() == 0) {
        off();
        event(Fault::SENSOR_LOST, 0);
    }
    const float degrees = safety::get(P_position_scale) * (counts_of_position() - safety::get(P_position_zero));
    const control::Outcome how = control::step(degrees);
    if (how != control::GOING) event(how == control::ENDED ? Fault::TABLE_END : Fault::UNDERRUN, 0);
    uint8_t channel;
    const Fault met = safety::watch(control::driven(), channel);
    if (host_age < 0xffff) ++host_age;
    if (met && !fault) {
        fault = met;
        off();
        event(met, channel);
    } else if (control::mode() != control::IDLE && host_age > safety::get(P_host_timeout) * hardware::TICK_HZ) {
        off();
        event(Fault::HOST_TIMEOUT, 0);
    }
    apply();
    calibrate_tick();
    stream();
    resistance();
    hardware::pat_watchdog();
}

}  // namespace

void protocol::handle(const Command& command) {
    host_age = 0;
    uint32_t value = 0;
    const Status status = obey(command, value);
    reply(command.sequence, status, value);
}

int main() {
    hardware::begin();
    hardware::start_conversions(hardware::NO_SENSE);
    while (!hardware::converted()) {
    }
    safety::begin();
    banner();
    for (;;) {
        for (uint8_t byte; hardware::receive(byte);) protocol::take(byte);
        if (!converting && hardware::tick()) {
            converting = true;
            begin_tick();
        }
        if (converting && hardware::converted()) {
            converting = false;
            end_tick();
        }
        hardware::sleep_until_interrupt();
    }
}
