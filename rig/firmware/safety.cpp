#include "safety.h"

#include <math.h>

namespace safety {
namespace {

using hardware::CHANNELS;
using hardware::TICK_S;

enum May : uint8_t { FREE, LOWER, RAISE };
struct Rule {
    float start, low, high;
    May may;
};

const Rule RULES[] = {
#define X(name, start, low, high, may) {start, low, high, may},
    PARAMETERS(X)
#undef X
};

constexpr float ZERO_C = 273.15f;
constexpr uint16_t FULL = 4 * 1024;           // of a sum of four conversions
constexpr uint16_t OPEN = 4 * 3, SHORTED = 4 * 1020;
constexpr uint8_t PATIENCE = 4;               // ticks that a reading must last to be believed
constexpr float HANG_S = 0.3f;                // that a reset by the watchdog may have cost
constexpr float RECOVERED = 0.5f;             // share of a limit below which a fault may be cleared
constexpr float RECOVERED_K = 10.0f;

float values[PARAMETER_COUNT];
uint16_t hot_sum;                             // of a thermistor at the cut-out
uint8_t fitted_mask, hot_for[CHANNELS], lost_for[CHANNELS], current_for;

struct Memory {
    float temperature[CHANNELS];  // degC
    float energy[CHANNELS];       // J, beyond the sustained power
    float on[CHANNELS];           // s
    uint8_t driven[CHANNELS];
    uint8_t age;                  // which of two is the younger: counts up
    uint16_t check;
};
Memory memory;

// Kept over resets, for no reset makes an actuator cold: written in turn, so that one is whole whenever a reset comes.
Memory kept[2] __attribute__((section(".noinit")));

uint16_t check_of(const Memory& m) {  // Fletcher
    const uint8_t* const bytes = reinterpret_cast<const uint8_t*>(&m);
    uint8_t a = 0x5a, b = 0xc3;
    for (uint8_t i = 0; i < sizeof(Memory) - sizeof m.check; ++i) {
        a += bytes[i];
        b += a;
    }
    return static_cast<uint16_t>(a) << 8 | b;
}

void keep() {
    ++memory.age;
    memory.check = check_of(memory);
    kept[memory.age & 1] = memory;
}

// The younger of what was kept whole; false where nothing was, as when the power came.
bool recall() {
    const bool whole[2] = {kept[0].check == check_of(kept[0]), kept[1].check == check_of(kept[1])};
    if (!whole[0] && !whole[1]) return false;
    const bool second = !whole[0] || (whole[1] && static_cast<int8_t>(kept[1].age - kept[0].age) > 0);
    memory = kept[second];
    return true;
}

float power(uint8_t count) { return count / 255.0f * SUPPLY_V * SUPPLY_V / values[P_model_resistance]; }

void heat(uint8_t c, uint8_t count, float dt) {
    const float p = power(count);
    const float lost = values[P_model_conductance] * (memory.temperature[c] - values[P_model_ambient]);
    memory.temperature[c] += dt * (p - lost) / values[P_model_thermal_mass];
    memory.energy[c] = fmaxf(0.0f, memory.energy[c] + dt * (p - values[P_sustained_power]));
    memory.on[c] = fmaxf(0.0f, memory.on[c] + (count ? dt : -dt));
}

float cut_out() { return values[P_max_temperature] - MARGIN_K; }

void find_threshold() {
    const float r = NTC_NOMINAL_OHM * expf(NTC_BETA_K * (1.0f / (cut_out() + ZERO_C) - 1.0f / (25.0f + ZERO_C)));
    hot_sum = static_cast<uint16_t>(FULL * NTC_FIXED_OHM / (NTC_FIXED_OHM + r));
}

float read_temperature(uint8_t c) {
    const float share = (hardware::input(c) + 2.0f) / FULL;
    const float r = NTC_FIXED_OHM * (1.0f / share - 1.0f);
    return 1.0f / (1.0f / (25.0f + ZERO_C) + logf(r / NTC_NOMINAL_OHM) / NTC_BETA_K) - ZERO_C;
}

bool plausible(uint8_t c) { return hardware::input(c) >= OPEN && hardware::input(c) <= SHORTED; }

}  // namespace

void begin() {
    for (uint8_t i = 0; i < PARAMETER_COUNT; ++i) values[i] = RULES[i].start;
    find_threshold();
    look_for_sensors();
    const bool known = recall();
    for (uint8_t c = 0; c < CHANNELS; ++c) {
        if (known) {
            if (memory.driven[c]) heat(c, memory.driven[c], HANG_S);
        } else {
            memory.temperature[c] = values[P_model_ambient];
            memory.energy[c] = memory.on[c] = 0.0f;
        }
        if (fitted_mask & 1 << c) memory.temperature[c] = fmaxf(memory.temperature[c], read_temperature(c));
        memory.driven[c] = 0;
    }
    keep();
}

float get(uint8_t parameter) { return values[parameter]; }

bool set(uint8_t parameter, float value) {
    const Rule& rule = RULES[parameter];
    if (!(value >= rule.low && value <= rule.high)) return false;
    if (rule.may == LOWER && value > values[parameter]) return false;
    if (rule.may == RAISE && value < values[parameter]) return false;
    values[parameter] = value;
    if (parameter == P_max_temperature) find_threshold();
    return true;
}

Fault watch(const uint8_t driven[CHANNELS], uint8_t& channel) {
    for (uint8_t c = 0; c < CHANNELS; ++c) {
        heat(c, driven[c], TICK_S);
        memory.driven[c] = driven[c];
        const bool seen = fitted_mask & 1 << c;
        hot_for[c] = seen && hardware::input(c) >= hot_sum ? hot_for[c] + 1 : 0;
        lost_for[c] = seen && !plausible(c) ? lost_for[c] + 1 : 0;
        if (hot_for[c] > PATIENCE) hot_for[c] = PATIENCE;
        if (lost_for[c] > PATIENCE) lost_for[c] = PATIENCE;
    }
    keep();
    const float amperes = (hardware::input(3) + 2.0f) / FULL * 5.0f / CURRENT_V_PER_A;
    current_for = amperes > values[P_max_current] ? current_for + 1 : 0;
    if (current_for > PATIENCE) current_for = PATIENCE;
    for (channel = 0; channel < CHANNELS; ++channel) {
        if (memory.temperature[channel] >= cut_out()) return HOT_BY_MODEL;
        if (hot_for[channel] >= PATIENCE) return HOT_BY_SENSOR;
        if (lost_for[channel] >= PATIENCE) return SENSOR_LOST;
        if (memory.energy[channel] >= values[P_max_energy]) return OVER_ENERGY;
        if (memory.on[channel] >= values[P_max_on]) return ON_TOO_LONG;
    }
    channel = 0;
    return current_for >= PATIENCE ? OVER_CURRENT : NONE;
}

bool may_clear() {
    for (uint8_t c = 0; c < CHANNELS; ++c) {
        if (memory.temperature[c] > cut_out() - RECOVERED_K || hot_for[c] || lost_for[c]) return false;
        if (memory.energy[c] > RECOVERED * values[P_max_energy]) return false;
        if (memory.on[c] > RECOVERED * values[P_max_on]) return false;
    }
    return current_for == 0;
}

bool may_hang() {
    const float joules = HANG_S * power(255);
    for (uint8_t c = 0; c < CHANNELS; ++c) {
        if (memory.temperature[c] + joules / values[P_model_thermal_mass] >= cut_out() || hot_for[c]) return false;
        if (memory.energy[c] + joules >= values[P_max_energy] || memory.on[c] + HANG_S >= values[P_max_on]) return false;
    }
    return true;
}

void look_for_sensors() {
    for (uint8_t c = 0; c < CHANNELS; ++c) {
        if (plausible(c)) fitted_mask |= 1 << c;
    }
}

uint8_t fitted() { return fitted_mask; }

float temperature(uint8_t channel) { return memory.temperature[channel]; }

}  // namespace safety
