// The nearest points in cells of cameras' fields of view.
#include "arrays.h"

#include <cmath>
#include <limits>

namespace {

LIDCAM_HOT void find_nearest(const float *T, const float *low, const float *cell, float near_m, const float *xyz,
                             int64_t count, int64_t rows, int64_t columns, float *nearest) {
    for (int64_t i = 0; i < rows * columns; i++) nearest[i] = std::numeric_limits<float>::infinity();
    for (int64_t p = 0; p < count; p++) {
        const float *point = xyz + 3 * p;
        const float x = T[0] * point[0] + T[1] * point[1] + T[2] * point[2] + T[3];
        const float y = T[4] * point[0] + T[5] * point[1] + T[6] * point[2] + T[7];
        const float z = T[8] * point[0] + T[9] * point[1] + T[10] * point[2] + T[11];
        if (!(z > near_m)) continue;
        const float column = (x / z - low[0]) / cell[0], row = (y / z - low[1]) / cell[1];
        if (!(column >= 0 && column < float(columns) && row >= 0 && row < float(rows))) continue;
        float &own = nearest[int64_t(row) * columns + int64_t(column)];
        const float range = std::sqrt(x * x + y * y + z * z);
        own = range < own ? range : own;
    }
}

nb::object nearest_in_cells(In3<float> matrices, In2<float> low, In2<float> cell, In2<float> xyz, int64_t rows,
                            int64_t columns, float near_m) {
    const size_t cameras = matrices.shape(0);
    Out<float> nearest({cameras, size_t(rows), size_t(columns)});
    {
        nb::gil_scoped_release unlocked;
        for (size_t c = 0; c < cameras; c++)
            find_nearest(matrices.data() + 16 * c, low.data() + 2 * c, cell.data() + 2 * c, near_m, xyz.data(),
                         xyz.shape(0), rows, columns, nearest.data() + c * rows * columns);
    }
    return nearest.numpy();
}

}  // namespace

void add_visibility(nb::module_ &kernels) {
    kernels.def("nearest_in_cells", &nearest_in_cells, array("matrices"), array("low"), array("cell"), array("xyz"),
                nb::arg("rows"), nb::arg("columns"), nb::arg("near_m"));
}
