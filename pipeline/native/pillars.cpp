// The features of the points in pillars, see `detectors.pillars.grid`.
#include "arrays.h"

#include <cmath>
#include <vector>

namespace pillars {

constexpr size_t FEATURE_COUNT = 8;

struct Grid {
    double cell_m, half_m;
    int64_t cells;
    double low_m, high_m, step_m;
};

// A pillar with points.
struct Pillar {
    double x, y, z;  // sums over its points
    int64_t count;
};

// The points inside the grid, one after another.
struct Points {
    double *x_y;        // (P, 2) rounded to steps
    float *features;    // (P, 8) height, and offsets from the middle of the pillar
    int64_t *cell;      // (P,) the cell of the pillar
    int64_t *pillar;    // (P,) the pillar, among those with points
    double *height;     // (P,) rounded to steps
};

// How many points are inside the grid.
LIDCAM_HOT int64_t take_inside(const double *position, int64_t count, const Grid &grid, Points points,
                               std::vector<int32_t> &pillar_of_cell, std::vector<Pillar> &pillars) {
    const double cells = double(grid.cells);
    int64_t taken = 0;
    for (int64_t i = 0; i < count; i++) {
        const double x = std::nearbyint(position[3 * i] / grid.step_m) * grid.step_m;
        const double y = std::nearbyint(position[3 * i + 1] / grid.step_m) * grid.step_m;
        const double z = std::nearbyint(position[3 * i + 2] / grid.step_m) * grid.step_m;
        const double across = (x + grid.half_m) / grid.cell_m, along = (y + grid.half_m) / grid.cell_m;
        const double column = std::floor(across), row = std::floor(along);
        const bool is_inside = column >= 0 && column < cells && row >= 0 && row < cells;
        if (!(is_inside && z >= grid.low_m && z < grid.high_m)) continue;
        const int64_t cell = int64_t(row) * grid.cells + int64_t(column);
        if (pillar_of_cell[cell] < 0) {
            pillar_of_cell[cell] = int32_t(pillars.size());
            pillars.push_back({});
        }
        Pillar &pillar = pillars[pillar_of_cell[cell]];
        pillar.x += x;
        pillar.y += y;
        pillar.z += z;
        pillar.count++;
        points.x_y[2 * taken] = x;
        points.x_y[2 * taken + 1] = y;
        points.height[taken] = z;
        points.cell[taken] = cell;
        points.pillar[taken] = pillar_of_cell[cell];
        float *features = points.features + FEATURE_COUNT * taken;
        features[4] = float(across - column - 0.5);
        features[5] = float(along - row - 0.5);
        taken++;
    }
    return taken;
}

// Replaces the sums over the points of each pillar by their means, and the pillar of each point by its count.
void finish(int64_t count, double cell_m, Points points, std::vector<Pillar> &pillars) {
    for (Pillar &pillar : pillars) {
        pillar.x /= double(pillar.count);
        pillar.y /= double(pillar.count);
        pillar.z /= double(pillar.count);
    }
    for (int64_t i = 0; i < count; i++) {
        const Pillar &pillar = pillars[points.pillar[i]];
        float *features = points.features + FEATURE_COUNT * i;
        features[0] = float(points.height[i]);
        features[1] = float((points.x_y[2 * i] - pillar.x) / cell_m);
        features[2] = float((points.x_y[2 * i + 1] - pillar.y) / cell_m);
        features[3] = float(points.height[i] - pillar.z);
        points.pillar[i] = pillar.count;
    }
}

nb::object pillar_features(In2<double> position, double cell_m, int64_t cells, double low_m, double high_m,
                           double step_m) {
    const size_t count = position.shape(0);
    Out<float> features({count, FEATURE_COUNT});
    Out<int64_t> cell({count}), counts({count});
    Out<double> x_y({count, 2});
    size_t taken = 0;
    {
        nb::gil_scoped_release unlocked;
        std::vector<int32_t> pillar_of_cell(size_t(cells * cells), -1);
        std::vector<Pillar> pillars;
        std::vector<double> height(count);
        const Points points{x_y.data(), features.data(), cell.data(), counts.data(), height.data()};
        const Grid grid{cell_m, cell_m * double(cells) / 2, cells, low_m, high_m, step_m};
        taken = size_t(take_inside(position.data(), int64_t(count), grid, points, pillar_of_cell, pillars));
        finish(int64_t(taken), cell_m, points, pillars);
    }
    return nb::make_tuple(features.numpy(taken), cell.numpy(taken), counts.numpy(taken), x_y.numpy(taken));
}

void add(nb::module_ &kernels) {
    kernels.def("pillar_features", &pillar_features, array("position"), nb::arg("cell_m"), nb::arg("cells"),
                nb::arg("low_m"), nb::arg("high_m"), nb::arg("step_m"));
}

}  // namespace pillars
