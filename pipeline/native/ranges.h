// The least and the largest of many values.
#pragma once

#include "arrays.h"

#include <algorithm>

// Of at least one value; several at a time, since each comparison waits for the one before.
template <int LANES = 4, class T> LIDCAM_PART void range_of(const T *values, int64_t count, T &low, T &high) {
    T lows[LANES], highs[LANES];
    for (int lane = 0; lane < LANES; lane++) lows[lane] = highs[lane] = values[0];
    int64_t i = 0;
    for (; i + LANES <= count; i += LANES) {
        for (int lane = 0; lane < LANES; lane++) {
            lows[lane] = values[i + lane] < lows[lane] ? values[i + lane] : lows[lane];
            highs[lane] = values[i + lane] > highs[lane] ? values[i + lane] : highs[lane];
        }
    }
    for (; i < count; i++) {
        lows[0] = std::min(lows[0], values[i]);
        highs[0] = std::max(highs[0], values[i]);
    }
    low = *std::min_element(lows, lows + LANES);
    high = *std::max_element(highs, highs + LANES);
}
