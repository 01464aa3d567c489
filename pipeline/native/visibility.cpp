// The nearest points in cells of cameras' fields of view.
#include "arrays.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace visibility {

// How the cells of a camera lie: the transform (4, 4) to it, low ends and cell sizes across and down.
struct View {
    const float *T, *low, *cell;
    float near_m;
    int rows, columns;
};

// Points taken at once.
constexpr int64_t BLOCK = 64;

// The cell of each of the points (count, 3), or -1, and its range.
LIDCAM_HOT void find_cells(const float *xyz, int64_t count, const View &view, int *__restrict cells,
                           float *__restrict ranges_m) {
    float T[12];
    std::copy_n(view.T, 12, T);
    const auto [_, low, cell, near_m, rows, columns] = view;
    const float left = low[0], top = low[1], width = cell[0], height = cell[1];
    for (int64_t p = 0; p < count; p++) {
        const float *point = xyz + 3 * p;
        const float x = T[0] * point[0] + T[1] * point[1] + T[2] * point[2] + T[3];
        const float y = T[4] * point[0] + T[5] * point[1] + T[6] * point[2] + T[7];
        const float z = T[8] * point[0] + T[9] * point[1] + T[10] * point[2] + T[11];
        const float column = (x / z - left) / width, row = (y / z - top) / height;
        const bool is_across = (column >= 0) & (column < float(columns)), is_down = (row >= 0) & (row < float(rows));
        const bool is_inside = (z > near_m) & is_across & is_down;
        cells[p] = is_inside ? int(is_inside ? row : 0) * columns + int(is_inside ? column : 0) : -1;
        ranges_m[p] = std::sqrt(x * x + y * y + z * z);
    }
}

void find_nearest(const float *xyz, int64_t count, const View &view, float *nearest) {
    int cells[BLOCK];
    float ranges_m[BLOCK];
    std::fill_n(nearest, view.rows * view.columns, std::numeric_limits<float>::infinity());
    for (int64_t first = 0; first < count; first += BLOCK) {
        const int64_t taken = std::min(BLOCK, count - first);
        find_cells(xyz + 3 * first, taken, view, cells, ranges_m);
        for (int64_t p = 0; p < taken; p++)
            if (cells[p] >= 0) nearest[cells[p]] = std::min(nearest[cells[p]], ranges_m[p]);
    }
}

nb::object nearest_in_cells(In3<float> matrices, In2<float> low, In2<float> cell, In2<float> xyz, int rows,
                            int columns, float near_m) {
    const size_t cameras = matrices.shape(0);
    Out<float> nearest({cameras, size_t(rows), size_t(columns)});
    {
        nb::gil_scoped_release unlocked;
        for (size_t c = 0; c < cameras; c++) {
            const View view{matrices.data() + 16 * c, low.data() + 2 * c, cell.data() + 2 * c, near_m, rows, columns};
            find_nearest(xyz.data(), int64_t(xyz.shape(0)), view, &nearest[c * rows * columns]);
        }
    }
    return nearest.numpy();
}

void add(nb::module_ &kernels) {
    kernels.def("nearest_in_cells", &nearest_in_cells, array("matrices"), array("low"), array("cell"), array("xyz"),
                nb::arg("rows"), nb::arg("columns"), nb::arg("near_m"));
}

}  // namespace visibility
