// Oriented rectangles around clusters seen from above: see `detectors/cluster/lshape.py`.
#include "arrays.h"
#include "ranges.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

namespace lshape {

constexpr double INFINITE = std::numeric_limits<double>::infinity();

// Distance from a side, as a share of the cluster's diagonal, that hardly lowers closeness: sides are rounded.
constexpr double SOFT_SHARE = 0.08;

// Cells along the diagonal of a cluster that is thinned before the search.
constexpr int64_t CELLS_ACROSS = 24;

// Resolution of the bounds during the search, along a cluster.
constexpr int BINS = 48;

// Maximum share of the points outside at each side during the search.
constexpr double TRIM_SHARE = 0.04;

// The points of a cluster, thinned, and what the search needs room for: along the two axes of a direction, the places
// of the points and the bins of these.
struct Shape {
    explicit Shape(size_t room)
        : x(room), y(room), weight(room), forward(room), left(room), near(room), bin_forward(room), bin_left(room) {}
    int64_t count = 0;
    std::vector<double> x, y, weight, forward, left, near;
    std::vector<int32_t> bin_forward, bin_left;
};

// Means of the points in the cells of a cluster's own grid, in the order of the cells.
class Thinning {
  public:
    explicit Thinning(size_t room) : cell_(room), x_(room), y_(room) {}

    void operator()(const double *xy, int64_t width, int64_t count, const double *low, double cell_m, Shape &shape) {
        constexpr int64_t across = CELLS_ACROSS + 1;
        std::array<int64_t, across * across + 1> place = {};
        for (int64_t i = 0; i < count; i++) {
            const int64_t column = int64_t((xy[width * i] - low[0]) / cell_m);
            cell_[i] = column * across + int64_t((xy[width * i + 1] - low[1]) / cell_m);
            place[cell_[i] + 1]++;
        }
        for (size_t k = 1; k < place.size(); k++) place[k] += place[k - 1];
        for (int64_t i = 0; i < count; i++) {
            const int64_t to = place[cell_[i]]++;
            x_[to] = xy[width * i];
            y_[to] = xy[width * i + 1];
        }
        shape.count = 0;
        int64_t first = 0;  // each place is the end of its cell now
        for (int64_t k = 0; k < across * across; k++) {
            const int64_t size = place[k] - first;
            if (size == 0) continue;
            double east = 0.0, north = 0.0;
            for (; first < place[k]; first++) {
                east += x_[first];
                north += y_[first];
            }
            shape.x[shape.count] = east / double(size);
            shape.y[shape.count] = north / double(size);
            shape.weight[shape.count++] = double(size);
        }
    }

  private:
    std::vector<int64_t> cell_;
    std::vector<double> x_, y_;
};

// Moves the ends of a histogram inwards, with at most the mass `outside` behind either; masses are whole, and sums
// exact.
LIDCAM_PART void trim(const double *mass, double total, double outside, double step, double &low, double &high) {
    int first = 0, last = BINS;
    double below = mass[0], above = mass[BINS - 1];
    const double inside = total - outside;
    while (below <= outside) below += mass[++first];
    while (total - above >= inside) above += mass[--last - 1];
    high = low + last * step;
    low = low + first * step;
}

// The direction of which the sides are closest to the points.
LIDCAM_HOT int64_t closest_direction(Shape &shape, double soft_m, const double *cos, const double *sin, int64_t coarse,
                                     int64_t fine) {
    const int64_t count = shape.count;
    const double *east = shape.x.data(), *north = shape.y.data(), *weight = shape.weight.data();
    double *__restrict forward = shape.forward.data(), *__restrict left = shape.left.data();
    double *__restrict near = shape.near.data();
    int32_t *__restrict bin_forward = shape.bin_forward.data(), *__restrict bin_left = shape.bin_left.data();
    const double soft = soft_m * soft_m;
    double total = 0.0;
    for (int64_t i = 0; i < count; i++) total += weight[i];
    int64_t best = 0, skipped = 0;
    double closest = -INFINITE;
    for (int64_t k = 0; k < coarse + fine; k++) {
        if (k == coarse) {
            skipped = best * fine;
            closest = -INFINITE;
        }
        const double x = cos[skipped + k], y = sin[skipped + k];
        for (int64_t i = 0; i < count; i++) {
            forward[i] = east[i] * x + north[i] * y;
            left[i] = north[i] * x - east[i] * y;
        }
        double low, high, low_left, high_left;
        range_of(forward, count, low, high);
        range_of(left, count, low_left, high_left);
        const double step = std::max((high - low) / BINS, 1e-9);
        const double step_left = std::max((high_left - low_left) / BINS, 1e-9);
        for (int64_t i = 0; i < count; i++) {
            const double place = (forward[i] - low) / step, place_left = (left[i] - low_left) / step_left;
            bin_forward[i] = int32_t(place < BINS - 1.0 ? place : BINS - 1.0);
            bin_left[i] = int32_t(place_left < BINS - 1.0 ? place_left : BINS - 1.0);
        }
        double mass[BINS] = {}, mass_left[BINS] = {};
        for (int64_t i = 0; i < count; i++) {
            mass[bin_forward[i]] += weight[i];
            mass_left[bin_left[i]] += weight[i];
        }
        trim(mass, total, TRIM_SHARE * total, step, low, high);
        trim(mass_left, total, TRIM_SHARE * total, step_left, low_left, high_left);
        for (int64_t i = 0; i < count; i++) {
            const double below = std::abs(forward[i] - low), above = std::abs(forward[i] - high);
            const double right = std::abs(left[i] - low_left), beyond = std::abs(left[i] - high_left);
            const double along = below < above ? below : above, across = right < beyond ? right : beyond;
            const double gap = along < across ? along : across;
            near[i] = weight[i] / std::sqrt(gap * gap + soft);
        }
        double closeness = 0.0;
        for (int64_t i = 0; i < count; i++) closeness += near[i];
        if (closeness > closest) {
            best = skipped + k;
            closest = closeness;
        }
    }
    return best;
}

int64_t longest(const int64_t *ends, size_t clusters) {
    int64_t most = 0, start = 0;
    for (size_t c = 0; c < clusters; start = ends[c++]) most = std::max(most, ends[c] - start);
    return most;
}

nb::object closest_directions(In2<double> xy, In1<int64_t> ends, In2<double> low, In1<double> diagonal_m,
                              In1<double> cos, In1<double> sin, int64_t coarse) {
    const size_t clusters = ends.shape(0);
    Out<int64_t> found({clusters});
    {
        nb::gil_scoped_release unlocked;
        const int64_t most = longest(ends.data(), clusters), width = xy.shape(1);
        const int64_t fine = int64_t(cos.shape(0)) / coarse - 1;
        Thinning thin(most);
        Shape shape(most);
        int64_t start = 0;
        for (size_t c = 0; c < clusters; start = ends.data()[c++]) {
            const double across_m = diagonal_m.data()[c];
            thin(xy.data() + width * start, width, ends.data()[c] - start, low.data() + 2 * c,
                 across_m / CELLS_ACROSS, shape);
            found[c] = closest_direction(shape, SOFT_SHARE * across_m, cos.data(), sin.data(), coarse, fine);
        }
    }
    return found.numpy();
}

// A quantile, rounded outwards to the next value; of fewer than a hundred values it is an end as a rule.
double quantile_of(const double *values, int64_t count, double share, std::vector<double> &room) {
    const double place = share * double(count - 1);
    const int64_t rank = int64_t(share < 0.5 ? std::floor(place) : std::ceil(place));
    double low, high;
    if (rank == 0 || rank == count - 1) {
        range_of(values, count, low, high);
    } else {
        room.assign(values, values + count);
        std::nth_element(room.begin(), room.begin() + rank, room.end());
        low = room[rank];
    }
    return (rank > 0 && rank == count - 1 ? high : low) + 0.0;  // positive, whichever of the two zeros came first
}

nb::object quantiles(In1<double> values, In1<int64_t> ends, double share) {
    const size_t clusters = ends.shape(0);
    Out<double> found({clusters});
    {
        nb::gil_scoped_release unlocked;
        std::vector<double> room;
        int64_t start = 0;
        for (size_t c = 0; c < clusters; start = ends.data()[c++]) {
            found[c] = quantile_of(values.data() + start, ends.data()[c] - start, share, room);
        }
    }
    return found.numpy();
}

nb::tuple rectangles(In2<double> xy, In1<int64_t> ends, In1<double> cos, In1<double> sin, double outside_share) {
    const size_t clusters = ends.shape(0);
    Out<double> low({clusters, 2}), high({clusters, 2}), residual_m({clusters});
    {
        nb::gil_scoped_release unlocked;
        const int64_t most = longest(ends.data(), clusters), width = xy.shape(1);
        std::vector<double> along[2] = {std::vector<double>(most), std::vector<double>(most)}, room;
        int64_t start = 0;
        for (size_t c = 0; c < clusters; start = ends.data()[c++]) {
            const int64_t count = ends.data()[c] - start;
            const double x = cos.data()[c], y = sin.data()[c], *at = xy.data() + width * start;
            for (int64_t i = 0; i < count; i++, at += width) {
                along[0][i] = at[0] * x + at[1] * y;
                along[1][i] = at[1] * x - at[0] * y;
            }
            for (int axis = 0; axis < 2; axis++) {
                low(c, axis) = quantile_of(along[axis].data(), count, outside_share, room);
                high(c, axis) = quantile_of(along[axis].data(), count, 1.0 - outside_share, room);
            }
            double square = 0.0;
            for (int64_t i = 0; i < count; i++) {
                double gap = INFINITE;
                for (int axis = 0; axis < 2; axis++) {
                    gap = std::min(gap, std::abs(along[axis][i] - low(c, axis)));
                    gap = std::min(gap, std::abs(along[axis][i] - high(c, axis)));
                }
                square += gap * gap;
            }
            residual_m[c] = std::sqrt(square / double(count));
        }
    }
    return nb::make_tuple(low.numpy(), high.numpy(), residual_m.numpy());
}

void add(nb::module_ &kernels) {
    kernels.def("closest_directions", &closest_directions, array("xy"), array("ends"), array("low"),
                array("diagonal_m"), array("cos"), array("sin"), nb::arg("coarse"));
    kernels.def("quantiles", &quantiles, array("values"), array("ends"), nb::arg("share"));
    kernels.def("rectangles", &rectangles, array("xy"), array("ends"), array("cos"), array("sin"),
                nb::arg("outside_share"));
}

}  // namespace lshape
