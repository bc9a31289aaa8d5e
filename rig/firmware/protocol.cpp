#include "protocol.h"

#include <avr/pgmspace.h>

#include "hardware.h"

namespace protocol {
namespace {

constexpr uint8_t LONGEST = 96;

const uint32_t TABLE[16] PROGMEM = {0x00000000, 0x1db71064, 0x3b6e20c8, 0x26d930ac, 0x76dc4190, 0x6b6b51f4,
                                    0x4db26158, 0x5005713c, 0xedb88320, 0xf00f9344, 0xd6d6a3e8, 0xcb61b38c,
                                    0x9b64c2b0, 0x86d3d2d4, 0xa00ae278, 0xbdbdf21c};

uint32_t sum(uint32_t crc, uint8_t byte) {
    crc ^= byte;
    crc = pgm_read_dword(&TABLE[crc & 15]) ^ (crc >> 4);
    return pgm_read_dword(&TABLE[crc & 15]) ^ (crc >> 4);
}

uint16_t sequence, bad;
uint32_t crc;

char line[LONGEST];
uint8_t length;
bool inside;

void put(uint8_t byte) {
    crc = sum(crc, byte);
    hardware::send(byte);
}

char digit(uint8_t value) { return value < 10 ? '0' + value : 'A' + value - 10; }

int8_t value_of(char c) {
    if (c >= '0' && c <= '9') return c - '0';
    if (c >= 'A' && c <= 'F') return c - 'A' + 10;
    return -1;
}

bool hexadecimal(const char* from, const char* to, uint32_t& value) {
    value = 0;
    if (from == to || to - from > 8) return false;
    for (; from != to; ++from) {
        const int8_t v = value_of(*from);
        if (v < 0) return false;
        value = value << 4 | static_cast<uint8_t>(v);
    }
    return true;
}

bool whole(Command& command) {  // "K,0001,FF,..*CCCCCCCC" in line
    if (length < 15 || line[length - 9] != '*' || line[1] != ',') return false;
    const char* const star = line + length - 9;
    uint32_t said, made = 0xffffffff;
    if (!hexadecimal(star + 1, line + length, said)) return false;
    for (const char* c = line; c != star; ++c) made = sum(made, *c);
    if (said != ~made) return false;
    command.kind = line[0];
    command.count = 0;
    bool first = true;
    for (const char* from = line + 2; from <= star;) {
        const char* to = from;
        while (to != star && *to != ',') ++to;
        uint32_t value;
        if (!hexadecimal(from, to, value)) return false;
        if (first) {
            command.sequence = value;
            first = false;
        } else {
            if (command.count == sizeof command.fields / sizeof command.fields[0]) return false;
            command.fields[command.count++] = value;
        }
        from = to + 1;
    }
    return true;
}

}  // namespace

bool begin(char kind, uint32_t stamp, uint8_t bytes) {
    ++sequence;
    if (hardware::room() < bytes) return false;
    hardware::send('$');
    crc = 0xffffffff;
    put(kind);
    field(sequence, 4);
    field(stamp, 8);
    return true;
}

void field(uint32_t value, uint8_t digits) {
    put(',');
    while (digits) put(digit(value >> (4 * --digits) & 15));
}

void text(const char* flash) {
    put(',');
    for (char c; (c = pgm_read_byte(flash)); ++flash) put(c);
}

void integer(uint32_t value) {
    char digits[10];
    uint8_t n = 0;
    do {
        digits[n++] = '0' + value % 10;
        value /= 10;
    } while (value);
    put(',');
    while (n) put(digits[--n]);
}

void end() {
    const uint32_t made = ~crc;
    hardware::send('*');
    for (uint8_t i = 8; i;) hardware::send(digit(made >> (4 * --i) & 15));
    hardware::send('\n');
}

void take(uint8_t byte) {
    if (byte == '$') {
        if (inside) ++bad;
        inside = true;
        length = 0;
    } else if (inside && byte == '\n') {
        inside = false;
        Command command;
        if (whole(command)) {
            handle(command);
        } else {
            ++bad;
        }
    } else if (inside && byte != '\r') {
        if (length == LONGEST) {
            inside = false;
            ++bad;
        } else {
            line[length++] = byte;
        }
    }
}

uint16_t bad_frames() { return bad; }

}  // namespace protocol
