// The least and the largest of many values.
#pragma once

#include <algorithm>
#include <cstdint>

// Of at least one value; four at a time, since each comparison waits for the one before.
static inline __attribute__((always_inline)) void range_of(const double *values, int64_t count, double &low,
                                                           double &high) {
    double lows[4], highs[4];
    for (int lane = 0; lane < 4; lane++) lows[lane] = highs[lane] = values[0];
    int64_t i = 0;
    for (; i + 4 <= count; i += 4) {
        for (int lane = 0; lane < 4; lane++) {
            lows[lane] = values[i + lane] < lows[lane] ? values[i + lane] : lows[lane];
            highs[lane] = values[i + lane] > highs[lane] ? values[i + lane] : highs[lane];
        }
    }
    for (; i < count; i++) {
        lows[0] = std::min(lows[0], values[i]);
        highs[0] = std::max(highs[0], values[i]);
    }
    low = *std::min_element(lows, lows + 4);
    high = *std::max_element(highs, highs + 4);
}
