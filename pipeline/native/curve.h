// Points in their order along a curve that fills space, so that those near in the order are near in space.
//
// Hilbert's curve, computed after Skilling (Programming the Hilbert curve, AIP Conference Proceedings 707, 2004).
#pragma once

#include "arrays.h"
#include "radix.h"
#include "ranges.h"

#include <algorithm>
#include <numeric>
#include <vector>

namespace curve {

constexpr int AXIS_BITS = 11;
constexpr int CELLS = 1 << AXIS_BITS;  // of the curve along each axis

// A point is one number while points are sorted: its index in these bits, its place on the curve above them.
constexpr int ROW_BITS = 63 - 3 * AXIS_BITS;
constexpr int64_t ROW = (int64_t(1) << ROW_BITS) - 1;

constexpr int CHUNK = 1024;  // points that are numbered at once, so that their cells stay in the processor's cache
constexpr int CROWD = 256;   // more points than this in one cell are sorted anew, in smaller cells

LIDCAM_HOT void find_ends(const float *values, int64_t count, float &low, float &high) {
    range_of<16>(values, count, low, high);
}

// Inverts the lower bits of x if the bit is set in the other number; else exchanges those of both.
LIDCAM_PART void turn(int32_t &x, int32_t &other, int32_t bit) {
    const int32_t lower = bit - 1;
    const int32_t exchanged = (other & bit) ? 0 : lower;
    const int32_t swapped = (x ^ other) & exchanged;
    x ^= swapped ^ lower ^ exchanged;
    other ^= swapped;
}

// Cells of a chunk as places on the curve, its bits dealt out to the three rows, the highest first.
LIDCAM_PART void number_cells(int32_t *x, int32_t *y, int32_t *z) {
    for (int place = AXIS_BITS - 1; place > 0; place--) {
        const int32_t bit = 1 << place;
        for (int j = 0; j < CHUNK; j++) {
            int32_t first = x[j], same = x[j];
            turn(first, same, bit);
            turn(first, y[j], bit);
            turn(first, z[j], bit);
            x[j] = first;
        }
    }
    for (int j = 0; j < CHUNK; j++) {
        y[j] ^= x[j];
        z[j] ^= y[j];
        int32_t odd = z[j] >> 1;
        odd ^= odd >> 1;
        odd ^= odd >> 2;
        odd ^= odd >> 4;
        odd ^= odd >> 8;
        x[j] ^= odd;
        y[j] ^= odd;
        z[j] ^= odd;
    }
}

// The lowest eleven bits of a number, each at three times its place.
LIDCAM_PART uint32_t apart(uint32_t bits) {
    bits = (bits | (bits << 16)) & 0x070000FF;
    bits = (bits | (bits << 8)) & 0x0700F00F;
    bits = (bits | (bits << 4)) & 0x430C30C3;
    return (bits | (bits << 2)) & 0x49249249;
}

// Places on the curve and rows, see `ROW`, of points.
LIDCAM_HOT void find_places(const float *const *xyz, int64_t count, const double *low, double scale, int64_t *places) {
    alignas(64) int32_t cells[3][CHUNK];
    for (int64_t start = 0; start < count; start += CHUNK) {
        const int size = int(std::min<int64_t>(CHUNK, count - start));
        for (int axis = 0; axis < 3; axis++) {
            const float *along = xyz[axis] + start;
            for (int j = 0; j < size; j++) cells[axis][j] = int32_t((along[j] - low[axis]) * scale) & (CELLS - 1);
            for (int j = size; j < CHUNK; j++) cells[axis][j] = 0;
        }
        number_cells(cells[0], cells[1], cells[2]);
        for (int axis = 0; axis < 3; axis++)
            for (int j = 0; j < CHUNK; j++) cells[axis][j] = int32_t(apart(uint32_t(cells[axis][j])));
        for (int j = 0; j < size; j++) {
            const int64_t place = (int64_t(cells[0][j]) << 2) | (int64_t(cells[1][j]) << 1) | cells[2][j];
            places[start + j] = (place << ROW_BITS) | (start + j);
        }
    }
}

// Indices of finite points, count >= 1, along the curve; points at one place by their indices.
inline void order_along_curve(const float *x, const float *y, const float *z, int64_t count, int64_t *order) {
    const float *xyz[3] = {x, y, z};
    double low[3], edge = 0;
    for (int axis = 0; axis < 3; axis++) {
        float lowest, highest;
        find_ends(xyz[axis], count, lowest, highest);
        low[axis] = lowest;
        edge = std::max(edge, highest - low[axis]);
    }
    if (edge == 0) {
        std::iota(order, order + count, 0);
        return;
    }
    std::vector<int64_t> places(count);
    find_places(xyz, count, low, (CELLS - 1) / edge, places.data());
    radix_sort(places, ROW_BITS, 63, [](int64_t place) { return uint64_t(place); });  // of one cell: by their rows
    for (int64_t i = 0; i < count; i++) order[i] = places[i] & ROW;
    for (int64_t begin = 0, end; begin < count; begin = end) {
        end = begin + 1;
        while (end < count && places[end] >> ROW_BITS == places[begin] >> ROW_BITS) end++;
        const int64_t crowded = end - begin;
        if (crowded <= CROWD) continue;
        const std::vector<int64_t> crowd(order + begin, order + end);
        std::vector<float> around(3 * crowded);
        for (int axis = 0; axis < 3; axis++)
            for (int64_t i = 0; i < crowded; i++) around[axis * crowded + i] = xyz[axis][crowd[i]];
        const float *first = around.data();
        order_along_curve(first, first + crowded, first + 2 * crowded, crowded, order + begin);
        for (int64_t i = begin; i < end; i++) order[i] = crowd[order[i]];
    }
}

}  // namespace curve
