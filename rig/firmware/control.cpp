#include "control.h"

#include "config.h"
#include "safety.h"

namespace control {
namespace {

using hardware::CHANNELS;
using hardware::TICK_S;

Mode now = IDLE;
uint8_t counts[CHANNELS];

uint16_t table[SLOTS];
uint16_t taken, given;         // entries used and received since the table was emptied
uint16_t entries;              // of the whole profile
uint8_t ticks_per_entry, wait;

struct Pid {  // thesis (3.16)-(3.18), forward Euler; the clamp looks at the sign of Ki e, as scpjax.control.pid
    float integral, filtered;

    float step(float sign, float error, float dt) {
        const float push = dt * sign * safety::get(P_ki) * error;
        const float derivative = safety::get(P_n) * (sign * safety::get(P_kd) * error - filtered);
        const float asked = sign * safety::get(P_kp) * error + integral + derivative;
        const float high = safety::get(P_effort_limit);
        const float effort = asked < 0.0f ? 0.0f : asked > high ? high : asked;
        if (asked == effort || push * asked <= 0.0f) integral += push;
        filtered += dt * derivative;
        return effort;
    }
};
Pid pids[CHANNELS];

uint8_t count_of(float effort) {  // heat goes with the duty: V^2 = duty * supply^2
    return static_cast<uint8_t>(255.0f * effort / (SUPPLY_V * SUPPLY_V) + 0.5f);
}

void off() { counts[0] = counts[1] = 0; }

}  // namespace

Mode mode() { return now; }

void stop() {
    now = IDLE;
    taken = given = entries = 0;
    off();
}

void hold(uint8_t agonist, uint8_t antagonist) {
    now = HOLD;
    counts[0] = agonist;
    counts[1] = antagonist;
}

uint16_t free_slots() { return SLOTS - 1 - (given - taken); }

uint16_t received() { return given; }

bool append(uint16_t index, uint16_t entry) {
    if (index != given) return false;
    table[given % SLOTS] = entry;
    ++given;
    return true;
}

bool start(Mode mode, uint8_t ticks, uint16_t count) {
    if (given == taken || ticks == 0 || count == 0) return false;
    now = mode;
    ticks_per_entry = ticks;
    entries = count;
    wait = 0;
    off();
    for (Pid& pid : pids) pid = Pid{0.0f, 0.0f};
    return true;
}

Outcome step(float degrees) {
    if (now != PLAY && now != LOOP) return GOING;
    if (wait) {
        --wait;
        return GOING;
    }
    if (taken == entries || taken == given) {
        const Outcome how = taken == entries ? ENDED : RAN_DRY;
        stop();
        return how;
    }
    const uint16_t entry = table[taken % SLOTS];
    ++taken;
    wait = ticks_per_entry - 1;
    if (now == PLAY) {
        counts[0] = entry >> 8;
        counts[1] = entry & 0xff;
    } else {
        const float error = static_cast<int16_t>(entry) * 0.01f - degrees;
        const float dt = ticks_per_entry * TICK_S;
        counts[0] = count_of(pids[0].step(1.0f, error, dt));
        counts[1] = safety::get(P_channels) < 2.0f ? 0 : count_of(pids[1].step(-1.0f, error, dt));
    }
    return GOING;
}

const uint8_t* driven() { return counts; }

}  // namespace control
