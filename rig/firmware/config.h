// What your bench is made of and the most that it may ever do. Change it here (or with make CONFIG="-D...") and flash:
// over the wire the limits can only be made tighter.
#pragma once

#ifndef SUPPLY_V
#define SUPPLY_V 3.7f  // battery
#endif
#ifndef MAX_TEMPERATURE_C
#define MAX_TEMPERATURE_C 120.0f  // cut-out, by thermistor and by estimate; nylon melts at 165
#endif
#ifndef MARGIN_K
#define MARGIN_K 2.0f  // the cut-out acts so far below the limit
#endif
#ifndef MAX_ENERGY_J
#define MAX_ENERGY_J 1000.0f  // of one actuator, beyond what it may have for ever
#endif
#ifndef SUSTAINED_POWER_W
#define SUSTAINED_POWER_W 6.0f  // that it may have for ever
#endif
#ifndef MAX_ON_S
#define MAX_ON_S 600.0f  // on less off
#endif
#ifndef MAX_CURRENT_A
#define MAX_CURRENT_A 9.0f  // of both channels together, mean over the PWM
#endif
#ifndef HOST_TIMEOUT_S
#define HOST_TIMEOUT_S 1.0f  // without a good frame from the host
#endif

// The thermal model C dT/dt = V^2 / R - lambda (T - ambient) that the board heats in its mind: take it rather too hot.
#ifndef MODEL_RESISTANCE_OHM
#define MODEL_RESISTANCE_OHM 1.07f
#endif
#ifndef MODEL_CONDUCTANCE_W_PER_K
#define MODEL_CONDUCTANCE_W_PER_K 0.14f
#endif
#ifndef MODEL_THERMAL_MASS_J_PER_K
#define MODEL_THERMAL_MASS_J_PER_K 1.1f
#endif
#ifndef MODEL_AMBIENT_C
#define MODEL_AMBIENT_C 25.0f
#endif

// Thermistor from 5 V to the tap, NTC_FIXED_OHM from the tap to ground.
#ifndef NTC_NOMINAL_OHM
#define NTC_NOMINAL_OHM 100e3f
#endif
#ifndef NTC_BETA_K
#define NTC_BETA_K 3950.0f
#endif
#ifndef NTC_FIXED_OHM
#define NTC_FIXED_OHM 10e3f
#endif

// Amplified shunt: volts at A3 per ampere.
#ifndef CURRENT_V_PER_A
#define CURRENT_V_PER_A 0.4f
#endif
