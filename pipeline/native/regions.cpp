// The points of a cloud in convex regions: most points are left out many at a time.
#include "arrays.h"

#include <algorithm>
#include <vector>

namespace {

// Successive points tested together: neighbours in a scan are neighbours in space.
constexpr int64_t RUN = 16;

// Least x, y, z and largest x, y, z of the points of a run.
struct Bounds {
    float ends[2][3];
};

std::vector<Bounds> bounds_of_runs(const float *xyz, int64_t count) {
    std::vector<Bounds> bounds((count + RUN - 1) / RUN);
    for (size_t run = 0; run < bounds.size(); run++) {
        const int64_t first = int64_t(run) * RUN, end = std::min(first + RUN, count);
        float *low = bounds[run].ends[0], *high = bounds[run].ends[1];
        std::copy_n(xyz + 3 * first, 3, low);
        std::copy_n(xyz + 3 * first, 3, high);
        for (int64_t i = first + 1; i < end; i++) {
            for (int axis = 0; axis < 3; axis++) {
                const float value = xyz[3 * i + axis];
                low[axis] = value < low[axis] ? value : low[axis];
                high[axis] = value > high[axis] ? value : high[axis];
            }
        }
    }
    return bounds;
}

// Whether a point is on the inner side of a plane a, b, c, d.
bool is_inside(const double *plane, float x, float y, float z) {
    return plane[0] * x + plane[1] * y + plane[2] * z + plane[3] >= 0;
}

// Whether no point of a run is on the inner side of a plane: its corner that is furthest inside; rounding is monotone.
bool is_outside(const double *plane, const Bounds &run) {
    const auto &ends = run.ends;
    return !is_inside(plane, ends[plane[0] > 0][0], ends[plane[1] > 0][1], ends[plane[2] > 0][2]);
}

nb::object points_in_regions(In2<float> xyz, In3<double> planes) {
    std::vector<int64_t> rows, regions;
    {
        nb::gil_scoped_release unlocked;
        const int64_t count = xyz.shape(0), region_count = planes.shape(0), plane_count = planes.shape(1);
        const float *points = xyz.data();
        const std::vector<Bounds> bounds = bounds_of_runs(points, count);
        for (int64_t region = 0; region < region_count; region++) {
            const double *around = planes.data() + 4 * plane_count * region;
            for (size_t run = 0; run < bounds.size(); run++) {
                int64_t k = 0;
                while (k < plane_count && !is_outside(around + 4 * k, bounds[run])) k++;
                if (k < plane_count) continue;
                const int64_t first = int64_t(run) * RUN, end = std::min(first + RUN, count);
                for (int64_t i = first; i < end; i++) {
                    const float *point = points + 3 * i;
                    k = 0;
                    while (k < plane_count && is_inside(around + 4 * k, point[0], point[1], point[2])) k++;
                    if (k < plane_count) continue;
                    rows.push_back(i);
                    regions.push_back(region);
                }
            }
        }
    }
    return nb::make_tuple(numpy_of(rows), numpy_of(regions));
}

}  // namespace

void add_regions(nb::module_ &kernels) {
    kernels.def("points_in_regions", &points_in_regions, array("xyz"), array("planes"));
}
