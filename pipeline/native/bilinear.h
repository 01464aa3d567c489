// Values between the nodes of a grid: a part of kernels (`Relief.offset_m` does it for arrays).
#pragma once

#include <algorithm>
#include <cstdint>

// Bilinear at a place in nodes of a grid (rows along y, columns along x); beyond the grid that of its edge.
inline double between(const double *values, int64_t height, int64_t width, double x, double y) {
    x = std::min(std::max(0.0, x), double(width - 1));
    y = std::min(std::max(0.0, y), double(height - 1));
    const int64_t column = std::min(int64_t(x), width - 2);
    const int64_t row = std::min(int64_t(y), height - 2);
    x -= double(column);
    y -= double(row);
    const double *node = values + row * width + column;
    const double near = node[0] * (1 - x) + node[1] * x;
    const double far = node[width] * (1 - x) + node[width + 1] * x;
    return near * (1 - y) + far * y;
}
