// The points of a cloud in convex regions: most points are left out many at a time.
#include "arrays.h"

#include <algorithm>
#include <vector>

namespace regions {

// Successive points tested together: neighbours in a scan are neighbours in space.
constexpr int64_t RUN = 16;

struct Plane {
    double a, b, c, d;
};

// Least (0) and largest (1) x, y, z of the points of each run.
struct Bounds {
    explicit Bounds(int64_t runs) {
        for (auto &end : ends)
            for (auto &axis : end) axis.resize(size_t(runs));
    }
    std::vector<double> ends[2][3];
};

Bounds bounds_of_runs(const float *xyz, int64_t count) {
    const int64_t runs = (count + RUN - 1) / RUN;
    Bounds bounds(runs);
    for (int64_t run = 0; run < runs; run++) {
        const int64_t first = run * RUN, end = std::min(first + RUN, count);
        float low[3], high[3];
        std::copy_n(xyz + 3 * first, 3, low);
        std::copy_n(xyz + 3 * first, 3, high);
        for (int64_t i = first + 1; i < end; i++) {
            for (int axis = 0; axis < 3; axis++) {
                const float value = xyz[3 * i + axis];
                low[axis] = value < low[axis] ? value : low[axis];
                high[axis] = value > high[axis] ? value : high[axis];
            }
        }
        for (int axis = 0; axis < 3; axis++) {
            bounds.ends[0][axis][run] = low[axis];
            bounds.ends[1][axis][run] = high[axis];
        }
    }
    return bounds;
}

// Clears the corners (count,) of runs that are outside of a plane.
LIDCAM_HOT void keep_inside(const Plane plane, const double *x, const double *y, const double *z, int64_t count,
                            uint8_t *__restrict is_inside) {
    for (int64_t run = 0; run < count; run++)
        is_inside[run] &= plane.a * x[run] + plane.b * y[run] + plane.c * z[run] + plane.d >= 0;
}

// Clears the points (count, 3) of a run that are outside of a plane.
LIDCAM_HOT void keep_points_inside(const Plane plane, const float *xyz, int64_t count, uint8_t *__restrict is_inside) {
    for (int64_t i = 0; i < count; i++)
        is_inside[i] &= plane.a * xyz[3 * i] + plane.b * xyz[3 * i + 1] + plane.c * xyz[3 * i + 2] + plane.d >= 0;
}

nb::object points_in_regions(In2<float> xyz, In3<double> planes) {
    std::vector<int64_t> rows, regions;
    {
        nb::gil_scoped_release unlocked;
        const int64_t count = xyz.shape(0), region_count = planes.shape(0), plane_count = planes.shape(1);
        const float *points = xyz.data();
        const Bounds bounds = bounds_of_runs(points, count);
        const int64_t runs = int64_t(bounds.ends[0][0].size());
        std::vector<uint8_t> is_near(runs);
        uint8_t is_within[RUN];
        for (int64_t region = 0; region < region_count; region++) {
            const double *first_plane = planes.data() + 4 * plane_count * region;
            std::vector<Plane> around;
            for (int64_t k = 0; k < plane_count; k++) {
                const double *plane = first_plane + 4 * k;
                around.push_back({plane[0], plane[1], plane[2], plane[3]});
            }
            std::fill(is_near.begin(), is_near.end(), 1);
            for (const Plane &plane : around) {
                // The corner of the run's bounds that is furthest inside; rounding is monotone.
                const auto &x = bounds.ends[plane.a > 0][0], &y = bounds.ends[plane.b > 0][1];
                keep_inside(plane, x.data(), y.data(), bounds.ends[plane.c > 0][2].data(), runs, is_near.data());
            }
            for (int64_t run = 0; run < runs; run++) {
                if (!is_near[run]) continue;
                const int64_t first = run * RUN, taken = std::min(RUN, count - first);
                std::fill_n(is_within, RUN, 1);
                for (const Plane &plane : around) keep_points_inside(plane, points + 3 * first, taken, is_within);
                for (int64_t i = 0; i < taken; i++) {
                    if (!is_within[i]) continue;
                    rows.push_back(first + i);
                    regions.push_back(region);
                }
            }
        }
    }
    return nb::make_tuple(numpy_of(rows), numpy_of(regions));
}

void add(nb::module_ &kernels) {
    kernels.def("points_in_regions", &points_in_regions, array("xyz"), array("planes"));
}

}  // namespace regions
