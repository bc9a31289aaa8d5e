// What the host may set: X(name, default, lowest, highest, may). FREE: anything between; LOWER, RAISE: only that way.
// scpjax/bench/parameters.py holds the same table; tests/bench/test_firmware_source.py compares them.
#pragma once

#define PARAMETERS(X)                                                          \
    X(kp, 0.5f, -1e6f, 1e6f, FREE)                                             \
    X(ki, 0.12f, -1e6f, 1e6f, FREE)                                            \
    X(kd, 0.47f, -1e6f, 1e6f, FREE)                                            \
    X(n, 5.84f, 1e-3f, 200.0f, FREE)                                           \
    X(effort_limit, SUPPLY_V* SUPPLY_V, 0.0f, SUPPLY_V* SUPPLY_V, FREE)        \
    X(position_scale, 0.0659824f, -1e6f, 1e6f, FREE)                           \
    X(position_zero, 2046.0f, -1e6f, 1e6f, FREE)                               \
    X(position_source, 0.0f, 0.0f, 2.0f, FREE)                                 \
    X(max_temperature, MAX_TEMPERATURE_C, 0.0f, 1000.0f, LOWER)                \
    X(max_energy, MAX_ENERGY_J, 0.0f, 1e6f, LOWER)                             \
    X(sustained_power, SUSTAINED_POWER_W, 0.0f, 1e6f, LOWER)                   \
    X(max_on, MAX_ON_S, 0.0f, 1e6f, LOWER)                                     \
    X(max_current, MAX_CURRENT_A, 0.0f, 1e6f, LOWER)                           \
    X(host_timeout, HOST_TIMEOUT_S, 0.05f, 1e6f, LOWER)                        \
    X(model_resistance, MODEL_RESISTANCE_OHM, 0.01f, 1e6f, LOWER)              \
    X(model_conductance, MODEL_CONDUCTANCE_W_PER_K, 1e-4f, 1e6f, LOWER)        \
    X(model_thermal_mass, MODEL_THERMAL_MASS_J_PER_K, 1e-2f, 1e6f, LOWER)      \
    X(model_ambient, MODEL_AMBIENT_C, -40.0f, 1000.0f, RAISE)          \
    X(channels, 2.0f, 1.0f, 2.0f, FREE)
