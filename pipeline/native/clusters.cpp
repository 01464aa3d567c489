// Thinning and single-linkage clustering of a cloud: see `detectors/cluster/clusters.py`.
#include "arrays.h"
#include "radix.h"
#include "ranges.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

namespace clusters {

constexpr double INFINITE = std::numeric_limits<double>::infinity();

// Steps of rounded coordinates in a metre (0.12 mm each), so float64 adds up a million of them exactly.
constexpr double RESOLUTION_PER_M = 8192.0;

// Maximum number of a cell along an axis: no float64 beyond fits into an int64.
constexpr double MAX_CELL = 2305843009213693952.0;  // 2^61

// Maximum number of a bucket along an axis of the search.
constexpr double MAX_BUCKET = 1099511627776.0;  // 2^40

// Buckets in a link distance; many small ones take longer than some points too many.
constexpr double BUCKETS_ACROSS = 1.0;

// Factor on the distance of the search, more than any rounding takes.
constexpr double ROOM = 1.0 + 1e-6;

// The last step of a rising series that a value reaches; 0 before the first.
LIDCAM_PART int64_t level_of(double value, const double *series, int64_t steps) {
    int64_t level = 0;
    while (level + 1 < steps && value >= series[level + 1]) level++;
    return level;
}

LIDCAM_PART double exact(double value) {
    return std::nearbyint(value * RESOLUTION_PER_M) / RESOLUTION_PER_M;
}

// The number of the cell of each point along x, y, z (3, N), whole; and the least and the largest of these.
LIDCAM_HOT void place_in_cells(const double *points, const double *edge_m, int64_t count, double *cell, double *lowest,
                               double *highest) {
    constexpr int64_t CHUNK = 512;  // of points that are read once for all axes
    for (int64_t start = 0; start < count; start += CHUNK) {
        const int64_t size = std::min(CHUNK, count - start);
        for (int axis = 0; axis < 3; axis++) {
            const double *point = points + 3 * start + axis, *edge = edge_m + start;
            double *along = cell + axis * count + start, low, high;
            for (int64_t i = 0; i < size; i++) along[i] = exact(point[3 * i]);
            for (int64_t i = 0; i < size; i++) {
                const double place = std::floor(along[i] / edge[i]), furthest = place > 0 ? MAX_CELL : -MAX_CELL;
                along[i] = std::abs(place) < MAX_CELL ? place : furthest;
            }
            range_of(along, size, low, high);
            lowest[axis] = std::min(lowest[axis], low);
            highest[axis] = std::max(highest[axis], high);
        }
    }
}

// Points that follow each other in the cloud and lie in one cell, as half of all do.
struct Run {
    uint64_t key;
    int64_t row;  // of the first one
};

// What is known of the points of a cell.
struct Cell {
    double sum[3] = {0.0, 0.0, 0.0}, distance_m = INFINITE;
    int64_t count = 0;
};

// Adds points to their cells.
LIDCAM_HOT void add_up(const double *points, const double *distance_m, int64_t count, const int64_t *cell_of_point,
                       Cell *cells) {
    for (int64_t i = 0; i < count; i++) {
        Cell &own = cells[cell_of_point[i]];
        own.count++;
        own.distance_m = std::min(own.distance_m, distance_m[i]);
        for (int axis = 0; axis < 3; axis++) own.sum[axis] += exact(points[3 * i + axis]);
    }
}

struct Cells {
    Out<double> means, distance_m;
    Out<int64_t> counts, first, cell_of_point;
};

Cells grouped(const double *points, const double *distance_m, int64_t count, double share, const double *edges_m,
              int64_t levels, const int64_t *group, int64_t groups) {
    const std::unique_ptr<uint64_t[]> keys(new uint64_t[count]);
    const std::unique_ptr<double[]> edge_m(new double[count]), cell(new double[3 * count]);
    for (int64_t i = 0; i < count; i++) {
        const int64_t level = level_of(share * distance_m[i], edges_m, levels);
        keys[i] = uint64_t(level * groups + group[i]);
        edge_m[i] = edges_m[level];
    }
    double lowest[3] = {INFINITE, INFINITE, INFINITE}, highest[3] = {-INFINITE, -INFINITE, -INFINITE};
    place_in_cells(points, edge_m.get(), count, cell.get(), lowest, highest);
    for (int axis = 0; axis < 3; axis++) {  // keys rise by level, group, and place along x, y, z
        const double *along = cell.get() + axis * count;
        const uint64_t low = uint64_t(int64_t(lowest[axis])), span = uint64_t(int64_t(highest[axis])) - low + 1;
        for (int64_t i = 0; i < count; i++) keys[i] = keys[i] * span + (uint64_t(int64_t(along[i])) - low);
    }

    std::vector<Run> runs(count);
    size_t found = 1;
    runs[0] = {keys[0], 0};
    for (int64_t i = 1, row = 0; i < count; i++) {  // without a branch, since every other one would be foretold wrongly
        const bool is_new = keys[i] != keys[i - 1];
        row = is_new ? i : row;
        found += is_new;
        runs[found - 1] = {keys[i], row};
    }
    runs.resize(found);
    uint64_t largest = 0;
    for (const Run &run : runs) largest = std::max(largest, run.key);
    int bits = 0;
    while (bits < 64 && largest >> bits) bits++;
    radix_sort(runs, 0, bits, [](const Run &run) { return run.key; });
    size_t used = 0;
    for (size_t k = 0; k < found; k++) used += k == 0 || runs[k].key != runs[k - 1].key;

    Cells made = {Out<double>({used, 3}, unset), Out<double>({used}, unset), Out<int64_t>({used}, unset),
                  Out<int64_t>({used}, unset), Out<int64_t>({size_t(count)}, unset)};
    int64_t own = -1;
    for (size_t k = 0; k < found; k++) {
        if (k == 0 || runs[k].key != runs[k - 1].key) made.first[++own] = runs[k].row;
        made.cell_of_point[runs[k].row] = own;
    }
    own = made.cell_of_point[0];
    for (int64_t i = 1; i < count; i++) {
        own = keys[i] == keys[i - 1] ? own : made.cell_of_point[i];
        made.cell_of_point[i] = own;
    }
    std::vector<Cell> cells(used);
    add_up(points, distance_m, count, made.cell_of_point.data(), cells.data());
    for (size_t k = 0; k < used; k++) {
        for (int axis = 0; axis < 3; axis++) made.means(k, axis) = cells[k].sum[axis] / double(cells[k].count);
        made.distance_m[k] = cells[k].distance_m;
        made.counts[k] = cells[k].count;
    }
    return made;
}

nb::tuple cells_of_points(In2<double> points, In1<double> distance_m, double share, In1<double> edges_m,
                          In1<int64_t> group, int64_t groups) {
    Cells made = [&] {
        nb::gil_scoped_release unlocked;
        return grouped(points.data(), distance_m.data(), points.shape(0), share, edges_m.data(), edges_m.shape(0),
                       group.data(), groups);
    }();
    return nb::make_tuple(made.means.numpy(), made.distance_m.numpy(), made.counts.numpy(), made.first.numpy(),
                          made.cell_of_point.numpy());
}

// Bucket of a coordinate along a grid, clamped at the first and the last one.
LIDCAM_PART int64_t bucket_of(double way_m, double per_m) {
    const double place = way_m * per_m;
    if (!(way_m > 0.0)) return 0;
    return int64_t(place < MAX_BUCKET ? place : MAX_BUCKET);
}

// A square grid of the points of a level of distances. It has more squares than there are buckets: after the last one
// comes the first one again, and what lies in it by chance is too far away.
struct Grid {
    int64_t size = 0, first = 0, mask = 0, columns = 0, lines = 0;
    double per_m = 0.0, longest_m = 0.0;
    double low[2] = {INFINITE, INFINITE}, high[2] = {-INFINITE, -INFINITE};

    int64_t bucket(int64_t column, int64_t line) const {  // unsigned: of a huge grid the product wraps
        return first + int64_t((uint64_t(column) * uint64_t(lines) + uint64_t(line)) & uint64_t(mask));
    }
};

// Points of a bucket stand together.
struct Near {
    double x, y, z, distance_m2;
    int64_t row;
};

int64_t link(const double *points, const double *distance_m, int64_t count, const double *series, int64_t levels,
             int64_t *part) {
    std::vector<Grid> grids(levels);
    std::vector<int64_t> level(count), bucket(count), reached(count);
    for (int64_t i = 0; i < count; i++) {
        level[i] = level_of(distance_m[i], series, levels);
        Grid &grid = grids[level[i]];
        grid.size++;
        grid.longest_m = std::max(grid.longest_m, distance_m[i]);
        for (int axis = 0; axis < 2; axis++) {
            grid.low[axis] = std::min(grid.low[axis], points[3 * i + axis]);
            grid.high[axis] = std::max(grid.high[axis], points[3 * i + axis]);
        }
    }
    int64_t buckets = 0;
    for (Grid &grid : grids) {
        int64_t size = 1;
        while (size < 2 * grid.size) size *= 2;
        grid.first = buckets;
        grid.mask = size - 1;
        grid.per_m = BUCKETS_ACROSS / grid.longest_m;
        grid.columns = bucket_of(grid.high[0] - grid.low[0], grid.per_m) + 1;
        grid.lines = bucket_of(grid.high[1] - grid.low[1], grid.per_m) + 1;
        buckets += size;
    }
    std::vector<int64_t> stops(buckets + 1);
    for (int64_t i = 0; i < count; i++) {
        const Grid &grid = grids[level[i]];
        bucket[i] = grid.bucket(bucket_of(points[3 * i] - grid.low[0], grid.per_m),
                                bucket_of(points[3 * i + 1] - grid.low[1], grid.per_m));
        stops[bucket[i] + 1]++;
    }
    for (int64_t k = 0; k < buckets; k++) stops[k + 1] += stops[k];
    const std::vector<int64_t> starts = stops;
    std::vector<Near> near(count);
    for (int64_t i = 0; i < count; i++) {
        const double *at = points + 3 * i;
        near[stops[bucket[i]]++] = {at[0], at[1], at[2], distance_m[i] * distance_m[i], i};
    }

    int64_t parts = 0;
    std::fill(part, part + count, -1);
    for (int64_t seed = 0; seed < count; seed++) {
        if (part[seed] >= 0) continue;
        part[seed] = parts;
        reached[0] = seed;
        for (int64_t done = 0, found = 1; done < found; done++) {
            const int64_t row = reached[done];
            const double x = points[3 * row], y = points[3 * row + 1], z = points[3 * row + 2];
            const double own_m2 = distance_m[row] * distance_m[row];
            for (const Grid &grid : grids) {
                if (grid.size == 0) continue;
                const double reach_m = std::min(distance_m[row], grid.longest_m) * ROOM;
                const double east = x - grid.low[0], north = y - grid.low[1];
                const int64_t first_line = bucket_of(north - reach_m, grid.per_m);
                const int64_t stop_column = std::min(bucket_of(east + reach_m, grid.per_m) + 1, grid.columns);
                const int64_t stop_line = std::min(bucket_of(north + reach_m, grid.per_m) + 1, grid.lines);
                for (int64_t column = bucket_of(east - reach_m, grid.per_m); column < stop_column; column++) {
                    for (int64_t line = first_line; line < stop_line; line++) {
                        const int64_t k = grid.bucket(column, line);
                        int64_t place = starts[k];
                        while (place < stops[k]) {
                            const Near &other = near[place];
                            const double dx = x - other.x, dy = y - other.y, dz = z - other.z;
                            if (!(dx * dx + dy * dy + dz * dz <= std::min(own_m2, other.distance_m2))) {
                                place++;
                                continue;
                            }
                            if (part[other.row] < 0) {
                                part[other.row] = parts;
                                reached[found++] = other.row;
                            }
                            near[place] = near[--stops[k]];
                        }
                    }
                }
            }
        }
        parts++;
    }
    return parts;
}

nb::tuple linked_parts(In2<double> points, In1<double> distance_m, In1<double> series) {
    Out<int64_t> part({points.shape(0)});
    int64_t parts;
    {
        nb::gil_scoped_release unlocked;
        parts = link(points.data(), distance_m.data(), points.shape(0), series.data(), series.shape(0), part.data());
    }
    return nb::make_tuple(parts, part.numpy());
}

void add(nb::module_ &kernels) {
    kernels.def("cells_of_points", &cells_of_points, array("points"), array("distance_m"), nb::arg("share"),
                array("edges_m"), array("group"), nb::arg("groups"));
    kernels.def("linked_parts", &linked_parts, array("points"), array("distance_m"), array("series"));
}

}  // namespace clusters
