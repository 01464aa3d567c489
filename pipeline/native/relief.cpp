// A surface that differs from the ground's plane: the lowest points of cells, and its growth towards them.
#include "arrays.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <vector>

namespace relief {

constexpr int64_t BLOCK = 512;  // sums made at once, so that they stay in the processor's cache

// Writes the cells of points near a plane, the first and the last of them, and the heights above it; returns how many
// points these are.
LIDCAM_HOT int64_t find_heights(const float *x, const float *y, const float *z, int64_t count, const float *plane,
                                const float *middle, const float *origin, float cell_m, int64_t side, float reach_m,
                                float slope, int32_t *cells, float *heights, int32_t &first, int32_t &last) {
    int64_t kept = 0;
    int32_t lowest = INT32_MAX, highest = -1;
    const float end = float(side);
    for (int64_t i = 0; i < count; i++) {
        const float height = (x[i] * plane[0] + y[i] * plane[1] + z[i] * plane[2] + plane[3]) / plane[2];
        if (std::abs(height) > reach_m) {
            const float dx = x[i] - middle[0], dy = y[i] - middle[1];
            if (!(std::abs(height) <= reach_m + slope * std::sqrt(dx * dx + dy * dy))) continue;
        }
        const float column = std::floor((x[i] - origin[0]) / cell_m), row = std::floor((y[i] - origin[1]) / cell_m);
        if (0 <= column && column < end && 0 <= row && row < end) {
            const int32_t cell = int32_t(row) * int32_t(side) + int32_t(column);
            lowest = std::min(lowest, cell);
            highest = std::max(highest, cell);
            cells[kept] = cell;
            heights[kept] = height;
            kept++;
        }
    }
    first = lowest;
    last = highest;
    return kept;
}

nb::tuple lowest_heights(In2<float> points, In1<float> plane, In1<float> middle, In1<float> origin, float cell_m,
                         int64_t side, float reach_m, float slope, float layer_m) {
    std::vector<int64_t> found;
    std::vector<double> means, extents;
    {
        nb::gil_scoped_release unlocked;
        const int64_t count = int64_t(points.shape(1));
        const float *x = points.data();
        const std::unique_ptr<int32_t[]> cells(new int32_t[count]);
        const std::unique_ptr<float[]> heights(new float[count]);
        int32_t first, last;
        const int64_t kept =
            find_heights(x, x + count, x + 2 * count, count, plane.data(), middle.data(), origin.data(), cell_m, side,
                         reach_m, slope, cells.get(), heights.get(), first, last);
        for (int64_t j = 0; j < kept; j++) cells[j] -= first;
        const int64_t size = kept > 0 ? last - first + 1 : 0;  // of the part of the grid that holds points
        std::vector<float> lowest(size, std::numeric_limits<float>::infinity());
        std::vector<float> highest(size, -std::numeric_limits<float>::infinity());
        for (int64_t j = 0; j < kept; j++) {
            lowest[cells[j]] = std::min(lowest[cells[j]], heights[j]);
            highest[cells[j]] = std::max(highest[cells[j]], heights[j]);
        }
        std::vector<int32_t> counts(size);
        std::vector<double> sums(size);
        for (int64_t j = 0; j < kept; j++) {
            if (heights[j] <= lowest[cells[j]] + layer_m) {
                counts[cells[j]]++;
                sums[cells[j]] += heights[j];
            }
        }
        for (int64_t cell = 0; cell < size; cell++) {
            if (counts[cell] == 0) continue;
            found.push_back(first + cell);
            means.push_back(sums[cell] / counts[cell]);
            extents.push_back(highest[cell] - lowest[cell]);
        }
    }
    return nb::make_tuple(numpy_of(found), numpy_of(means), numpy_of(extents));
}

// Writes sums of values, weighted by taps: sum i is about value i + stride x (taps to one side).
LIDCAM_HOT void find_sums(double *__restrict sums, const double *values, int64_t count, int64_t stride,
                          const double *taps, int64_t reach) {
    const double *middle = values + reach * stride;
    for (int64_t begin = 0; begin < count; begin += BLOCK) {
        const int64_t end = std::min(begin + BLOCK, count);
        for (int64_t i = begin; i < end; i++) sums[i] = middle[i] * taps[0];
        for (int64_t step = reach; step > 0; step--) {
            const double *before = middle - step * stride, *after = middle + step * stride, tap = taps[step];
            for (int64_t i = begin; i < end; i++) sums[i] += (before[i] + after[i]) * tap;
        }
    }
}

// A grid (height, width), 0 beyond its edges, smoothed along both axes, with a margin around it.
void smooth(const std::vector<double> &values, int64_t height, int64_t width, const double *taps, int64_t reach,
            int64_t margin, std::vector<double> &smoothed) {
    const int64_t rows = height + 2 * reach, line = width + 2 * margin;  // of the result: one row after another
    std::vector<double> padded((height + 4 * reach) * width), sums(rows * width), lines(rows * line + 2 * reach);
    std::copy(values.begin(), values.end(), padded.begin() + 2 * reach * width);
    find_sums(sums.data(), padded.data(), rows * width, width, taps, reach);
    for (int64_t row = 0; row < rows; row++)
        std::copy_n(sums.begin() + row * width, width, lines.begin() + row * line + reach + margin);
    const int64_t begin = (margin - reach) * line;
    std::fill_n(smoothed.begin(), begin, 0.0);
    std::fill_n(smoothed.begin() + begin + rows * line, begin, 0.0);
    find_sums(smoothed.data() + begin, lines.data(), rows * line, 1, taps, reach);
}

nb::object grown_surface(In2<double> xy, In1<double> heights_m, In1<double> standing_weights, int64_t side, In1<double> all_taps, In1<int64_t> counts,
                         In1<double> near_m, double standing_m, double max_weight, double prior_weight,
                         double fill_weight) {
    Out<double> offsets_m({size_t(side), size_t(side)});
    const int64_t count = int64_t(xy.shape(0)), rounds = int64_t(near_m.shape(0));
    if (count > 0) {
        nb::gil_scoped_release unlocked;
        // The nodes that are pulled, and a margin to which smoothing carries this on: elsewhere the surface stays zero.
        const double *places = xy.data();
        int64_t left = side, low = side, right = 0, high = 0;
        std::vector<int64_t> column_of(count), row_of(count);
        for (int64_t i = 0; i < count; i++) {
            const int64_t column = column_of[i] = int64_t(std::nearbyint(places[2 * i]));
            const int64_t row = row_of[i] = int64_t(std::nearbyint(places[2 * i + 1]));
            left = std::min(left, column);
            low = std::min(low, row);
            right = std::max(right, column);
            high = std::max(high, row);
        }
        const int64_t margin = *std::max_element(counts.data(), counts.data() + rounds + 2) - 1;
        const int64_t rows = high - low + 1, columns = right - left + 1, line = columns + 2 * margin;

        // Where the heights lie between the nodes of the surface, and the node that each one pulls.
        std::vector<int64_t> nodes(count), corners(count);
        std::vector<double> east(count), north(count);
        for (int64_t i = 0; i < count; i++) {
            const int64_t column = std::min(int64_t(places[2 * i]), side - 2);
            const int64_t row = std::min(int64_t(places[2 * i + 1]), side - 2);
            corners[i] = (row - low + margin) * line + column - left + margin;
            east[i] = places[2 * i] - column;
            north[i] = places[2 * i + 1] - row;
            nodes[i] = (row_of[i] - low) * columns + column_of[i] - left;
        }

        std::vector<double> weights(rows * columns), means(rows * columns), surface((rows + 2 * margin) * line);
        std::vector<double> sums(surface.size()), totals(surface.size());
        const double *taps = all_taps.data();
        for (int64_t k = 0; k < rounds; k++) {
            std::fill(weights.begin(), weights.end(), 0.0);
            std::fill(means.begin(), means.end(), 0.0);
            for (int64_t i = 0; i < count; i++) {
                const double *first = surface.data() + corners[i], *second = first + line;
                const double near = first[0] * (1 - east[i]) + first[1] * east[i];
                const double far = second[0] * (1 - east[i]) + second[1] * east[i];
                const double above = heights_m.data()[i] - (near * (1 - north[i]) + far * north[i]);
                if (std::abs(above) <= near_m.data()[k]) {
                    const double pull = above > standing_m ? standing_weights.data()[i] : 1.0;
                    weights[nodes[i]] += pull;
                    means[nodes[i]] += pull * above;
                }
            }
            for (size_t node = 0; node < weights.size(); node++) {
                means[node] /= std::max(weights[node], 1e-9);
                weights[node] = std::min(weights[node], max_weight);
                means[node] *= weights[node];
            }
            const int64_t reach = counts.data()[k] - 1;
            smooth(means, rows, columns, taps, reach, margin, sums);
            smooth(weights, rows, columns, taps, reach, margin, totals);
            for (size_t i = 0; i < surface.size(); i++) surface[i] += sums[i] / (totals[i] + prior_weight);
            taps += counts.data()[k];
        }

        // Where there are no cells, it goes on as it is nearby.
        for (int64_t row = 0; row < rows; row++) {
            for (int64_t column = 0; column < columns; column++) {
                const int64_t node = row * columns + column;
                weights[node] /= max_weight;
                means[node] = weights[node] * surface[(row + margin) * line + margin + column];
            }
        }
        const int64_t fill_reach = counts.data()[rounds] - 1, trust_reach = counts.data()[rounds + 1] - 1;
        std::vector<double> trusted(surface.size());
        smooth(means, rows, columns, taps, fill_reach, margin, sums);
        smooth(weights, rows, columns, taps, fill_reach, margin, totals);
        smooth(weights, rows, columns, taps + counts.data()[rounds], trust_reach, margin, trusted);
        for (int64_t row = std::max<int64_t>(low - margin, 0); row < std::min(high + margin + 1, side); row++) {
            for (int64_t column = std::max<int64_t>(left - margin, 0); column < std::min(right + margin + 1, side);
                 column++) {
                const int64_t i = (row - low + margin) * line + column - left + margin;
                const double trust = trusted[i] / (trusted[i] + fill_weight);
                const double filled = sums[i] / (totals[i] + fill_weight);
                offsets_m(row, column) = trust * surface[i] + (1 - trust) * filled;
            }
        }
    }
    return offsets_m.numpy();
}

void add(nb::module_ &kernels) {
    kernels.def("grown_surface", &grown_surface, array("xy"), array("heights_m"), array("standing_weights"), nb::arg("side"), array("taps"),
                array("counts"), array("near_m"), nb::arg("standing_m"), nb::arg("max_weight"), nb::arg("prior_weight"), nb::arg("fill_weight"));
    kernels.def("lowest_heights", &lowest_heights, array("points"), array("plane"), array("middle"), array("origin"),
                nb::arg("cell_m"), nb::arg("side"), nb::arg("reach_m"), nb::arg("slope"), nb::arg("layer_m"));
}

}  // namespace relief
