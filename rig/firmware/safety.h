// What may not happen whatever is commanded: limits of temperature, energy, time and current of each actuator.
#pragma once

#include <stdint.h>

#include "hardware.h"
#include "config.h"
#include "parameters.h"

enum Parameter : uint8_t {
#define X(name, start, low, high, may) P_##name,
    PARAMETERS(X)
#undef X
        PARAMETER_COUNT
};

namespace safety {

enum Fault : uint8_t {
    NONE,
    HOST_TIMEOUT,       // does not last: the next command is obeyed
    HOT_BY_MODEL,
    HOT_BY_SENSOR,
    OVER_CURRENT,
    OVER_ENERGY,
    ON_TOO_LONG,
    SENSOR_LOST,
    UNDERRUN,           // does not last
    TABLE_END           // no fault, an event
};

void begin();

float get(uint8_t parameter);
bool set(uint8_t parameter, float value);

// One tick under the counts driven since the last; returns the fault met and its channel.
Fault watch(const uint8_t driven[hardware::CHANNELS], uint8_t& channel);
bool may_clear();            // whether all that a fault guards has recovered

bool may_hang();             // whether the watchdog's test leaves every limit unmet

void look_for_sensors();     // thermistors that read plausibly count from now on
uint8_t fitted();            // a bit for each
float temperature(uint8_t channel);  // estimate, degC

}  // namespace safety
