// Passes over all points that find the ground plane and the points on it; sums run in the order of the points.
#include "arrays.h"
#include "bilinear.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <vector>

namespace ground {

// Points as a row per coordinate.
struct Points {
    const float *x, *y, *z;
    int64_t count;

    explicit Points(const In2<float> &rows)
        : x(rows.data()), y(x + rows.shape(1)), z(y + rows.shape(1)), count(int64_t(rows.shape(1))) {}
};

// Unit normal and offset.
struct Plane {
    float a, b, c, d;

    explicit Plane(const float *row) : a(row[0]), b(row[1]), c(row[2]), d(row[3]) {}
};

LIDCAM_PART float height_of(const Plane &plane, float x, float y, float z) {
    return x * plane.a + y * plane.b + z * plane.c + plane.d;
}

// How many heights are at most -3, -1, 1 and 3 layers.
LIDCAM_HOT void count_below(const float *x, const float *y, const float *z, int64_t count, Plane plane, float layer_m,
                            int32_t *below) {
    const float thrice_m = 3.0f * layer_m;
    int32_t deep = 0, low = 0, high = 0, top = 0;  // 32 bits: twice as many points at once
    for (int64_t i = 0; i < count; i++) {
        const float height = height_of(plane, x[i], y[i], z[i]);
        deep += height <= -thrice_m;
        low += height <= -layer_m;
        high += height <= layer_m;
        top += height <= thrice_m;
    }
    below[0] = deep;
    below[1] = low;
    below[2] = high;
    below[3] = top;
}

nb::tuple count_layers(In2<float> rows, In2<float> planes, float layer_m) {
    Out<int64_t> held({planes.shape(0)}, unset), beside({planes.shape(0)}, unset);
    {
        nb::gil_scoped_release unlocked;
        const Points points(rows);
        for (size_t k = 0; k < planes.shape(0); k++) {
            int32_t below[4];
            count_below(points.x, points.y, points.z, points.count, Plane(planes.data() + 4 * k), layer_m, below);
            held[k] = below[2] - below[1];
            beside[k] = std::max(below[1] - below[0], below[3] - below[2]);
        }
    }
    return nb::make_tuple(held.numpy(), beside.numpy());
}

// Points near a plane: their distances from it, and which ones they are.
struct Near {
    std::unique_ptr<float[]> heights;
    std::unique_ptr<int32_t[]> rows;
    int64_t count;
};

LIDCAM_HOT int64_t find_within(const float *x, const float *y, const float *z, int64_t count, Plane plane,
                               float limit_m, float *heights, int32_t *rows) {
    int64_t found = 0;
    for (int64_t i = 0; i < count; i++) {
        const float height = std::abs(height_of(plane, x[i], y[i], z[i]));
        heights[found] = height;  // written over by the next one if it is too far
        rows[found] = int32_t(i);
        found += height <= limit_m;
    }
    return found;
}

Near within(const Points &points, const Plane &plane, float limit_m) {
    Near near;
    near.heights.reset(new float[points.count]);
    near.rows.reset(new int32_t[points.count]);
    near.count = find_within(points.x, points.y, points.z, points.count, plane, limit_m, near.heights.get(),
                             near.rows.get());
    return near;
}

// Centre (3,) and covariance (3, 3) of some points; zeros of none.
struct Scatter {
    Out<double> centre{3}, covariance{3, 3};

    Scatter(const Points &points, const int32_t *rows, int64_t count) {
        if (count == 0) return;
        double x_sum = 0, y_sum = 0, z_sum = 0;
        for (int64_t j = 0; j < count; j++) {
            const int32_t i = rows[j];
            x_sum += points.x[i];
            y_sum += points.y[i];
            z_sum += points.z[i];
        }
        const double x_mean = centre[0] = x_sum / count;
        const double y_mean = centre[1] = y_sum / count;
        const double z_mean = centre[2] = z_sum / count;
        double xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;
        for (int64_t j = 0; j < count; j++) {
            const int32_t i = rows[j];
            const double x = points.x[i] - x_mean, y = points.y[i] - y_mean, z = points.z[i] - z_mean;
            xx += x * x;
            xy += x * y;
            xz += x * z;
            yy += y * y;
            yz += y * z;
            zz += z * z;
        }
        covariance(0, 0) = xx / count;
        covariance(1, 1) = yy / count;
        covariance(2, 2) = zz / count;
        covariance(0, 1) = covariance(1, 0) = xy / count;
        covariance(0, 2) = covariance(2, 0) = xz / count;
        covariance(1, 2) = covariance(2, 1) = yz / count;
    }
};

nb::tuple scatter_within(In2<float> rows, In1<float> plane, float limit_m) {
    std::optional<Scatter> scatter;
    {
        nb::gil_scoped_release unlocked;
        const Points points(rows);
        const Near near = within(points, Plane(plane.data()), limit_m);
        scatter.emplace(points, near.rows.get(), near.count);
    }
    return nb::make_tuple(scatter->centre.numpy(), scatter->covariance.numpy());
}

float median(std::vector<float> values) {
    const auto middle = values.begin() + values.size() / 2;
    std::nth_element(values.begin(), middle, values.end());
    const float lower = values.size() % 2 ? *middle : *std::max_element(values.begin(), middle);
    return (lower + *middle) / 2;
}

nb::tuple scatter_near(In2<float> rows, In1<float> plane, float layer_m) {
    std::optional<Scatter> scatter;
    int64_t count = 0;
    {
        nb::gil_scoped_release unlocked;
        const Points points(rows);
        const Near near = within(points, Plane(plane.data()), layer_m);
        int64_t nearest = 0;
        if (near.count > 0) {
            const double middle_m = median(std::vector<float>(near.heights.get(), near.heights.get() + near.count));
            const float near_m = std::min(layer_m, float(3 * 1.4826 * middle_m + 1e-6));
            for (int64_t j = 0; j < near.count; j++) {
                near.rows[nearest] = near.rows[j];
                nearest += near.heights[j] <= near_m;
            }
        }
        scatter.emplace(points, near.rows.get(), nearest);
        count = near.count;
    }
    return nb::make_tuple(count, scatter->centre.numpy(), scatter->covariance.numpy());
}

// Where the ground differs from its plane: see `Relief`.
struct Grid {
    double origin_x, origin_y, cell_m;
    const double *offsets_m;
    int64_t height, width;
};

// The rows that belong to each of three, see `parted`, and how many they are.
struct Parts {
    int64_t *left, *level, *above;
    int64_t left_count, level_count, above_count;
};

LIDCAM_HOT void part(const float *xyz, int64_t count, const bool *kept, Plane plane, double distance_m, Grid grid,
                     Parts &parts) {
    double lowest = 0, highest = 0;
    for (int64_t node = 0; node < grid.height * grid.width; node++) {
        lowest = std::min(lowest, grid.offsets_m[node]);
        highest = std::max(highest, grid.offsets_m[node]);
    }
    // Points beyond it are not on the ground anywhere; a bit more, to allow for rounding below.
    const double reach_m = distance_m + 1e-9 * (distance_m - lowest + highest);
    const double below_m = lowest - reach_m, above_m = highest + reach_m;
    const float plane_reach_m = float(distance_m);
    int64_t left = 0, level = 0, above = 0;
    for (int64_t i = 0; i < count; i++) {
        const float height = height_of(plane, xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]);
        const bool on_plane = std::abs(height) <= plane_reach_m;
        bool on_ground = false;
        if (below_m <= height && height <= above_m) {
            const double x = (xyz[3 * i] - grid.origin_x) / grid.cell_m;
            const double y = (xyz[3 * i + 1] - grid.origin_y) / grid.cell_m;
            on_ground = std::abs(height - between(grid.offsets_m, grid.height, grid.width, x, y)) <= distance_m;
        }
        // Written over by the next one that belongs there.
        parts.left[left] = parts.level[level] = parts.above[above] = i;
        left += kept[i] & !on_plane;
        level += kept[i] & on_plane;
        above += !on_ground;
    }
    parts.left_count = left;
    parts.level_count = level;
    parts.above_count = above;
}

nb::tuple parted(In2<float> xyz, In1<bool> kept, In1<float> plane, double distance_m, In1<double> origin_xy,
                 double cell_m, In2<double> offsets_m) {
    const size_t count = xyz.shape(0);
    Out<int64_t> left({count}, unset), level({count}, unset), above({count}, unset);
    Parts parts{left.data(), level.data(), above.data(), 0, 0, 0};
    {
        nb::gil_scoped_release unlocked;
        const double *origin = origin_xy.data();
        const int64_t height = int64_t(offsets_m.shape(0)), width = int64_t(offsets_m.shape(1));
        const Grid grid{origin[0], origin[1], cell_m, offsets_m.data(), height, width};
        part(xyz.data(), int64_t(count), kept.data(), Plane(plane.data()), distance_m, grid, parts);
    }
    return nb::make_tuple(left.numpy(parts.left_count), level.numpy(parts.level_count), above.numpy(parts.above_count));
}

void add(nb::module_ &kernels) {
    kernels.def("count_layers", &count_layers, array("points"), array("planes"), nb::arg("layer_m"));
    kernels.def("scatter_within", &scatter_within, array("points"), array("plane"), nb::arg("limit_m"));
    kernels.def("scatter_near", &scatter_near, array("points"), array("plane"), nb::arg("layer_m"));
    kernels.def("parted", &parted, array("xyz"), array("kept"), array("plane"), nb::arg("distance_m"),
                array("origin_xy"), nb::arg("cell_m"), array("offsets_m"));
}

}  // namespace ground
