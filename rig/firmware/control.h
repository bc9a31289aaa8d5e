// What the board does on its own from tick to tick: hold, play a table, or close the loop.
#pragma once

#include <stdint.h>

#include "hardware.h"

namespace control {

enum Mode : uint8_t { IDLE, HOLD, PLAY, LOOP };
constexpr uint16_t SLOTS = 256;  // of the table; one is kept free

Mode mode();
void stop();  // everything off, the table empty
void hold(uint8_t agonist, uint8_t antagonist);

// The table: pairs of counts to play, or references in hundredths of a degree. Entries come in order, from 0.
uint16_t free_slots();
uint16_t received();  // entries since the table was emptied
bool append(uint16_t index, uint16_t entry);  // false: not the next one
bool start(Mode mode, uint8_t ticks_per_entry, uint16_t entries);

enum Outcome : uint8_t { GOING, ENDED, RAN_DRY };
Outcome step(float degrees);  // one tick; sets driven
const uint8_t* driven();

}  // namespace control
