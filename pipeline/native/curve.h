// Points in their order along a curve that fills space.
#pragma once

#include <cstdint>

namespace curve {

// Indices of finite points, count >= 1, along the curve; points at one place by their indices.
void order_along_curve(const float *x, const float *y, const float *z, int64_t count, int64_t *order);

}  // namespace curve
