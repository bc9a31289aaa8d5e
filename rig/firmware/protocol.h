// Frames: "$" body "*" CRC-32 in eight hexadecimal digits, newline. The body is a letter and fields between commas.
#pragma once

#include <stdint.h>

namespace protocol {

constexpr uint8_t VERSION = 1;

enum Status : uint8_t { OK, UNKNOWN, BAD_ARGUMENTS, OUT_OF_RANGE, FAULTY, BUSY, FULL };

// From the board: kind, sequence number, micros; fields; end.
bool begin(char kind, uint32_t stamp, uint8_t length);  // false: there is no room, the frame is counted and left out
void field(uint32_t value, uint8_t digits);
void text(const char* flash);
void integer(uint32_t value);
void end();

// From the host, byte by byte; calls handle() for each good frame.
void take(uint8_t byte);
uint16_t bad_frames();

struct Command {
    char kind;
    uint16_t sequence;
    uint8_t count;            // of fields
    uint32_t fields[14];
};

void handle(const Command& command);  // in main.cpp

}  // namespace protocol
